"""Datasets of arrays: LeRobot, HDF5 of robomimic, time series of ``mujoco.sysid``.

Data flow: vector_entry -> episodes -> lerobot -> hdf5_file -> sysid_file.
"""
