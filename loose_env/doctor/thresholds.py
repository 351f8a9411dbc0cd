"""Decision thresholds of the preflight, each with its unit and its reason."""

# Sampling
UNEVEN_STEP = 0.1
"""Rms deviation of the time steps from their median, above which the sampling is called uneven
[median steps]: below, spectra change by less than 1 %."""
VERY_UNEVEN_STEP = 0.5
"""The same, above which samples that are taken as even are wrong by a step [median steps]."""
PAUSE_STEPS = 5.0
"""Step that counts as a pause [median steps]: a few missing rows are bridged by interpolation."""
PAUSE_S = 0.02
"""Shortest pause [s]: a slower recorder may skip a row without harm."""
LEAST_RATE_HZ = 20.0
"""Sampling rate below which the motion of an arm is not resolved [Hz]: its servos reach 5 to 10
Hz."""
BAND_SHARE = 0.4
"""Highest frequency of an excitation over the sampling rate: anti-aliasing filters need the
rest."""
BAND_POWER = 0.95
"""Share of the command's power that its band holds."""
LEAST_RUN_S = 0.5
"""Length of a run, below which its spectrum has few lines [s]."""

# Channels
NOTED_NAN = 0.0
"""Share of missing samples, above which the reader is told."""
LARGE_NAN = 0.05
"""Share of missing samples, above which it is a warning; 20 % is refused when a run is read."""
FROZEN_S = 0.02
"""Shortest time for which a noisy channel stands still to count as frozen [s]."""
FROZEN_SAMPLES = 20
"""Fewest samples of it."""
FROZEN_RATIO = 10.0
"""Length of such a piece over the channel's usual repetition (99 % of them)."""
HELD_SHARE = 0.8
"""Share of a channel's changes that come after the same number of rows, from which it counts as
sampled more slowly than the rows."""
CLIPPED_SHARE = 0.002
"""Share of samples at the channel's extreme value, from which it counts as clipped."""
CLIPPED_LEAST = 8
"""Fewest samples there."""
CLIPPED_PILE = 4.0
"""Samples at the extreme over those in each of the next levels: an honest tail thins out."""
LIMITED_SHARE = 0.01
"""Share of the commands at a limit of the actuator, above which they count as clipped."""
COARSE_STEP = 1.0
"""Resolution of a position sensor over the rms motion of its excited joint, above which the
motion is not resolved: rounding noise is then 30 % of it."""
LOST_VALUE = 3
"""Fewest samples of exactly zero in a row that count as a lost reading."""
LOST_RATIO = 8.0
"""Distance of zero from the channel's median [robust standard deviations] for that."""

# Ranges
HIGHEST_RATE_HZ = 1e6
"""Sampling rate above which times are not in seconds [Hz]: recorders of arms reach 100 kHz."""
OUT_OF_RANGE_RAD = 0.1
"""Excess over a joint's limit, above which it is a finding [rad]: a wrong zero is within."""
OUT_OF_RANGE_M = 0.02
"""The same of a prismatic joint [m]."""
OTHER_UNIT = 3.0
"""Reach of a position over its joint's limit, from which another unit is the reason and not a wrong
zero."""
MANY_TURNS_RAD = 20.0
"""Position of a hinge without limits, above which degrees are suspected [rad]: three turns."""
OVER_CONTROL_RANGE = 1.05
"""Command over its actuator's limit, above which it is a finding; the model clips it."""
FASTEST_RAD_S = 60.0
"""Joint speed above which the unit is doubted [rad/s]: fast arms reach 10 rad/s."""

# Units and signs
UNIT_MATCH = 0.2
"""Relative distance of a measured ratio from a unit's factor, up to which that unit is named:
gains, friction and damping change ratios by less."""
SCALE_NOTED = 0.25
"""Relative distance of a ratio from 1, above which the reader is told where no unit fits."""
SCALE_WRONG = 5.0
"""Ratio of two signals of one quantity, or its inverse, above which the reader is told where no
unit fits: a soft servo that swings its load stays below."""
SURE_CORRELATION = 0.8
"""Correlation of two channels, from which their sign and ratio are believed."""
LEAST_BLOCKS = 8
"""Block means by which slow signals are compared, at least."""
LEAST_SPREAD_RAD = 0.02
"""Rms of the positions over all runs, from which position and command are compared [rad or m]:
servo errors are smaller."""
LEAST_TORQUE_SHARE = 0.3
"""Least rms of the torque that the model needs over that recorded, or the reverse, for a sign:
friction may hide the rest."""
TORQUE_SIGN = (0.7, 1.4)
"""Ratio of recorded to needed torque between which minus one is a sign and not friction."""
UNCOUPLED = 0.1
"""Mean acceleration over gravity, below which an accelerometer does not measure gravity:
piezoelectric, or its mean was removed."""
TURNED_DEG = 15.0
"""Angle between measured and predicted gravity, above which it is a warning [deg]: mounting and
pose are known to a few degrees."""
WRONG_AXES_DEG = 40.0
"""The same, above which it is an error [deg]: no mounting tolerance reaches half a right angle."""
EXPLAINED_DEG = 8.0
"""Angle left by another order or sign of the axes, or of one joint, up to which that is named
[deg]."""

# Clocks
COHERENT = 0.7
"""Coherence of a line, from which its phase is used: its standard deviation over eight averages is
0.16 rad."""
HIGHEST_LINE_HZ = 500.0
"""Highest line used [Hz]: above, no arm between two sensors is rigid."""
FEWEST_LINES = 6
"""Coherent lines that an estimate of a delay needs."""
SEGMENTS = 8
"""Segments of a run whose spectra are averaged."""
LARGEST_DELAY_S = 0.05
"""Largest clock offset searched [s]: three periods at the lower end of a usual band."""
PHASE_FIT = 0.85
"""Mean resultant length of the phases after the delay is taken out, from which it is believed:
resonances between the two sensors turn the phase and leave less."""
RIVAL_FIT = 0.93
"""Fit of another delay over the best one, from which the delay is ambiguous."""
DELAY_Z = 4.0
"""Delay over its standard deviation, from which it is told."""
NOTED_DELAY_S = 5e-4
"""Delay from which it is told [s]: five standard deviations that a diagnosis allows for."""
LARGE_DELAY_S = 1e-3
"""Delay from which it is a warning [s]: 54 degrees of phase at 150 Hz."""
LATE_COMMAND_S = 0.02
"""Delay of motion behind a position command beside that of the model's servo, from which it is told
[s]: buses and drives of industrial arms take less."""
LARGEST_LAG_S = 0.4
"""Largest such delay searched [s]: hobby servos on a bus are 0.2 s late."""

# Entries
POSE_OFFSET = 0.05
"""Distance of a measured from a noted position, above which it is a finding [rad or m]."""
POSE_SPREAD = 0.2
"""Rms motion of a joint in a run with a noted pose, above which it is a finding [rad or m]."""
SILENT_COMMAND = 0.01
"""Power of a command over that of the strongest, below which its joint was not excited."""

# Effort
BLOCK_S = 0.1
"""Length of the block means of slow signals [s]."""
MOST_BLOCKS = 150
"""Blocks of a run that are compared, evenly chosen."""
MOST_SAMPLES = 8192
"""Samples of a run whose spectra are compared."""
MOST_SPECTRA = 8
"""Runs whose spectra are compared, evenly chosen."""
