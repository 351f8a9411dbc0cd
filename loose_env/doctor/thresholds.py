"""Decision thresholds of the preflight, each with its unit and its reason."""

# Sampling
UNEVEN_STEP = 0.1
"""Rms deviation of the time steps from their median, above which the sampling is called uneven
[median steps]: below, spectra change by less than 1 %."""
VERY_UNEVEN_STEP = 0.5
"""The same, above which it is a warning [median steps]: samples that are taken as even are then off
by a step."""
PAUSE_STEPS = 5.0
"""Step that counts as a pause [median steps]: a few missing rows are bridged by interpolation."""
PAUSE_S = 0.02
"""Shortest pause [s]: a slower recorder may skip a row without harm."""
LEAST_RATE_HZ = 20.0
"""Sampling rate below which the motion of an arm is not resolved [Hz]: its servos reach 5 to 10
Hz."""
SLOWEST_RATE_HZ = 4.5
"""Sampling rate below which times are not in seconds [Hz]: the slowest recorders of arms have 5
Hz, and the 1 to 4 kHz of usual drives read so where their times are in milliseconds."""
BAND_SHARE = 0.4
"""Highest frequency of an excitation over the sampling rate: anti-aliasing filters need the
rest."""
BAND_POWER = 0.95
"""Share of the command's power that its band holds: filters of noise roll off beyond their band."""
LEAST_RUN_S = 0.5
"""Length of a run, below which its spectrum has few lines [s]: 2 Hz between them."""
ODD_RATE = 0.2
"""Relative difference of a run's sampling rate from the median of all, above which it is a note:
two recorders, or times in another unit."""

# Channels
NOTED_NAN = 0.0
"""Share of missing samples, above which the reader is told: a recorder that works loses none."""
LARGE_NAN = 0.05
"""Share of missing samples, above which it is a warning: interpolation bridges fewer; 20 % is
refused when a run is read."""
FROZEN_S = 0.02
"""Shortest time for which a noisy channel stands still to count as frozen [s]: a period at the
middle of a usual band."""
FROZEN_SAMPLES = 20
"""Fewest samples of it: noise on several levels does not repeat one so often by chance."""
FROZEN_RATIO = 10.0
"""Length of such a piece over the channel's usual repetition (90 % of them): coarse channels repeat
by themselves."""
REPEATING_SHARE = 0.2
"""Share of pieces of two or more equal values, above which no piece of a channel is called frozen:
it is coarse or slow, and repeats by itself."""
FEWEST_PIECES = 10
"""Changes of a channel, from which its own rate, or a limit that it keeps reaching, is told: fewer
are a channel that rests."""
HELD_SHARE = 0.8
"""Share of a channel's changes that come after the same number of rows, from which it counts as
sampled more slowly than the rows: two clocks slip by a row now and then."""
CLIPPED_SHARE = 0.002
"""Share of samples at the channel's extreme value, from which it counts as clipped: two of a
thousand, a normal signal beyond three standard deviations."""
CLIPPED_LEAST = 8
"""Fewest samples there: short runs have that share by chance."""
FEWEST_LEVELS = 16
"""Values that a channel takes, below which it is too coarse to tell clipping: each level is hit
often."""
CLIPPED_PILE = 4.0
"""Samples at the extreme over those in each of the next levels: an honest tail thins out."""
LIMITED_SHARE = 0.01
"""Share of the commands at a limit of the actuator, above which they count as clipped: noise cut at
2.6 standard deviations loses 1 % of its samples."""
COARSE_LEVELS = 64
"""Values that a position takes, up to which its resolution is compared with its motion: with more,
rounding is small."""
COARSE_STEP = 1.0
"""Resolution of a position sensor over the rms motion of its excited joint, above which the
motion is not resolved: rounding noise is then 30 % of it."""
LOST_VALUE = 3
"""Fewest samples of exactly zero in a row that count as a lost reading: a signal that crosses zero
stays there for one."""
LOST_RATIO = 8.0
"""Distance of zero from the channel's median [robust standard deviations] for that: no reading of
the channel is so far away."""

# Ranges
HIGHEST_RATE_HZ = 1e6
"""Sampling rate above which times are not in seconds [Hz]: recorders of arms reach 100 kHz."""
OUT_OF_RANGE_RAD = 0.1
"""Excess over a joint's limit, above which it is a finding [rad]: a wrong zero is within."""
OUT_OF_RANGE_M = 0.02
"""The same of a prismatic joint [m]: a wrong zero is within."""
OTHER_UNIT = 3.0
"""Reach of a position over its joint's limit, from which another unit is the reason and not a wrong
zero: degrees reach 57 times as far."""
MANY_TURNS_RAD = 20.0
"""Position of a hinge without limits, above which degrees are suspected [rad]: three turns."""
OVER_CONTROL_RANGE = 1.05
"""Command over its actuator's limit, above which it is a finding: the model clips it."""
FASTEST_RAD_S = 60.0
"""Joint speed above which the unit is doubted [rad/s]: fast arms reach 10 rad/s."""

# Units and signs
UNIT_MATCH = 0.2
"""Relative distance of a measured ratio from a unit's factor, up to which that unit is named:
gains, friction and damping change ratios by less."""
SCALE_NOTED = 0.25
"""Relative distance of a ratio from 1, above which the reader is told where no unit fits:
sensitivities are known to 10 %."""
SCALE_WRONG = 5.0
"""Ratio of two signals of one quantity, or its inverse, above which the reader is told where no
unit fits: a soft servo that swings its load stays below."""
SURE_CORRELATION = 0.8
"""Correlation of two channels, from which their sign and ratio are believed: friction and noise
explain a third of the power at most."""
LEAST_BLOCKS = 8
"""Block means by which slow signals are compared, at least: a ratio of fewer scatters by more than
the units' factors are told apart."""
UNEVEN_BLOCK = 0.2
"""Relative deviation of the time between block means, above which no derivative is taken across:
there is a pause."""
FEWEST_POSES = 3
"""Runs in held poses, from which half of `LEAST_TORQUE_SHARE` is enough: friction does not follow
gravity from pose to pose."""
LEAST_SPREAD_RAD = 0.02
"""Rms of the positions over all runs, from which position and command are compared [rad or m]:
servo errors are smaller."""
LEAST_TORQUE_SHARE = 0.3
"""Least rms of the torque that the model needs over that recorded, or the reverse, for a sign:
friction may hide the rest."""
TORQUE_SIGN = (0.7, 1.4)
"""Size of the ratio of recorded to needed torque, between which a negative one is a wrong sign:
beyond, friction or a wrong gain has changed it."""
LEAST_POSE = 0.2
"""Largest noted position, below which measured positions are not compared with the notes [rad or
m]: ten times a wrong zero."""
LEAST_GRAVITY = 1.0
"""Acceleration that the model implies at rest, below which it has no gravity [m/s²]: models
for the moon have 1.6."""
UNCOUPLED = 0.13
"""Mean acceleration over gravity, below which an accelerometer does not measure gravity:
piezoelectric, or its mean was removed. A reading in g is 0.10 with 20 % of scatter."""
TURNED_DEG = 15.0
"""Angle between measured and predicted gravity, above which it is a warning [deg]: mounting and
pose are known to a few degrees."""
WRONG_AXES_DEG = 40.0
"""The same, above which it is an error [deg]: no mounting tolerance reaches half a right angle."""
EXPLAINED_DEG = 8.0
"""Angle left by another order or sign of the axes, or of one joint, up to which that is named
[deg]: mounting and pose are known to a few degrees."""
ALIKE_DEG = 1.0
"""Angle by which a further explanation may be worse than the best to be named too [deg]: less is
within the scatter of gravity over the poses."""

# Encoders
TURN_MATCH = 0.1
"""Relative distance of a jump from a turn, up to which it is one: the joint moves meanwhile."""
LARGEST_STEP_RAD = 1.5
"""Largest other step between two samples, up to which jumps by a turn are the encoder's [rad]:
recorders that lose rows make larger ones of any size."""
LEAST_TICKS = 50.0
"""Range of a position of whole numbers, from which they are encoder ticks: as radians they would
be eight turns."""
TICKS_MATCH = 0.03
"""Relative distance of the ticks per turn that commands imply from a power of two, up to which they
are that: servos follow slow commands to 3 %."""
FOLLOWS_COMMAND = 0.95
"""Correlation of a position with its command, from which the command tells its unit: lag and
friction leave a tenth of the power at most."""
FOLLOWS_OTHER = 0.9
"""Correlation of two positions with each other's commands, from which their servos are exchanged:
a servo that lags by half a radian of phase follows its own so."""
FOLLOWS_OWN = 0.6
"""Largest correlation of the same with their own commands for that: commands that are alike tell
nothing."""

# Alternatives
UNEXPLAINED = 0.1
"""Share of the torque's variance that model, friction and rotor inertia leave of the recording as
it stands, above which alternatives are tried: errors of payload and gravity remain below."""
CLEARER = 5.0
"""Share left as it stands over that left by an alternative, from which it is named: a free choice
among dozens of changes explains some of an unknown effect by chance."""
BETTER = 2.0
"""Share left by the best single error of the model (masses, a gain, a spring, an encoder's zero, a
tilted base) over that left by an alternative, from which the alternative is named: where both
explain the torques, the recording need not be wrong."""
EXPLAINED = 0.2
"""Largest share that an alternative may leave to be named: the right one leaves unmodelled effects
and noise."""
ALIKE_SHARE = 1.5
"""Share left by a further alternative over the best one, up to which it is named beside it: less is
within the scatter of the runs."""
LARGEST_GAIN = 4.0
"""Gain between recorded and needed torque, or its inverse, from which it is another quantity: gains
of drives and nominal inertias are off by less."""
LARGEST_ZERO_RAD = 0.5
"""Largest error of an encoder's zero that is tried beside the alternatives [rad]: the torque is
linear in it up to there."""
TURNED_GRAVITY_DEG = 15.0
"""Angle of fitted gravity to the model's, from which it points elsewhere [deg]: bases are level to
a few degrees."""
GRAVITY_MATCH = 0.3
"""Relative distance of the fitted gravity's size from the model's, up to which it is believed:
masses are off by less."""
LARGEST_OFFSET_S = 0.3
"""Largest clock offset of torques that is tried [s]: recorders started by hand are told by their
first motion."""
LEAST_OFFSET_S = 0.01
"""Least offset of them that is named [s]: below, rotor inertia and damping explain the same."""
STANDARD_SPEED = 0.05
"""Speed at which friction is 76 % of its slow value, over the joint's rms speed: noise of the
differentiated positions is below."""
TORQUE_BAND_HZ = 5.0
"""End of the band in which torques are compared for alternatives [Hz]: that of arm motion."""

# Clocks
COHERENT = 0.7
"""Coherence of a line, from which its phase is used: its standard deviation over eight averages is
0.16 rad."""
HIGHEST_LINE_HZ = 500.0
"""Highest line used [Hz]: above, no arm between two sensors is rigid."""
LEAST_POWER = 1e-4
"""Power of a line over that of the strongest, below which its phase is not used: leakage of the
window is as large."""
FEWEST_LINES = 6
"""Coherent lines that an estimate of a delay needs: fewer fit any delay."""
SEGMENTS = 8
"""Segments of a run whose spectra are averaged: the scatter of a coherence is then 0.1."""
WEAK_AXIS = 0.3
"""Motion of a sensor's axis over that of its strongest, below which its sign is not judged: the
strong axes leak into it."""
FLIPPED_SHARE = 0.75
"""Share of the runs against the motion, above which a sign is wrong: a resonance turns the phase of
single poses by pi as well."""
LARGEST_DELAY_S = 0.05
"""Largest clock offset searched [s]: three periods at the lower end of a usual band."""
PHASE_FIT = 0.85
"""Mean resultant length of the phases after the delay is taken out, from which it is believed:
resonances between the two sensors turn the phase and leave less."""
RIVAL_FIT = 0.93
"""Fit of another delay over the best one, from which the delay is ambiguous: a few lines of noise
decide between them."""
DELAY_Z = 4.0
"""Delay over its standard deviation, from which it is told: errors of the model are alike over
lines and runs, and the standard deviation counts them as independent."""
LEAST_PHASE_RAD = 0.1
"""Phase at the middle of the lines that a delay has to make to be told [rad]: sensors' filters and
mounting make as much."""
DELAY_SCATTER = 0.5
"""Scatter of the delay over runs and axes in units of the delay, above which it is no clock's: a
clock is late by the same time in all."""
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
"""Distance of a measured from a noted position, above which it is a finding, and a diagnosis tells
that it uses the measured one [rad or m]: servos sag by less."""
POSE_SPREAD = 0.2
"""Rms motion of a joint in a run with a noted pose, above which it is a finding, and a diagnosis
refuses the run [rad or m]: shaking about a pose stays within 0.1."""
SILENT_COMMAND = 0.01
"""Force of a command over that of the strongest [rms ratio], below which its joint was not excited:
as much leaks in from a controller that holds the joint."""

# Effort
BLOCK_S = 0.1
"""Length of the block means of slow signals [s]: a period at 10 Hz, where servos end."""
MOST_BLOCKS = 150
"""Blocks of a run that are compared, evenly chosen: 15 s, after which means no longer change."""
MOST_SAMPLES = 8192
"""Samples of a run whose spectra are compared: eight segments of a second at 1 kHz."""
MOST_SPECTRA = 8
"""Runs whose spectra are compared, evenly chosen: the preflight takes seconds."""
TORQUE_POINTS = 300
"""Points of a run at which torques are compared for alternatives: four coefficients of a joint are
fitted."""
TORQUE_RUNS = 4
"""Runs of that: all are of one recorder."""
SERVO_RUNS = 8
"""Runs whose positions are compared with each other's commands: all are of one cabling."""
