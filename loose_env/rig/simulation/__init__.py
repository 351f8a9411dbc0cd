"""Parts of simulated rigs: controls, engines, sensor readings, small-motion equations.

Data flow: controls -> engines -> reading -> slots -> small_motion -> lanes ->
small_motion_loop.
"""
