"""An arm integrated without MuJoCo."""
