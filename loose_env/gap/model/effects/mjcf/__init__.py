"""TODO room loose_env/gap/model/effects/mjcf."""
