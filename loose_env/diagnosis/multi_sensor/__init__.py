"""TODO room loose_env/diagnosis/multi_sensor."""
