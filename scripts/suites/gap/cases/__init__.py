"""Cases: arms, motions, sensors, effect sizes, recordings."""
