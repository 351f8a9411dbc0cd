"""Decision thresholds of the instrument as constants, each with its unit and its reason.

Shares and ratios are dimensionless; z-scores are in standard deviations. Values that a user may set
are fields of the settings beside this file. Constants of numerical methods stand beside their code.
"""

# Recordings
FEWEST_SAMPLES = 64
"""Samples a run needs: below, its spectrum has too few lines."""
BRIDGED_STEPS = 10.0
"""Dropout of a column that is interpolated [median steps of the column]; a longer one splits the
run."""
LONGEST_RUN_S = 86400.0
"""Longest run [s]: a longer one has a wrong time stamp."""
LARGEST_READING = 1000000.0
"""Largest magnitude of a reading [m/s², rad/s, rad, m]; a larger one is refused: the unit is
wrong."""
LARGEST_COMMAND = 1000000000.0
"""Largest magnitude of a command or torque [its own unit]; a larger one is refused."""
EXCITED_SHARE = 0.1
"""Power of a joint's command over that of the most excited joint, from which it counts as
excited."""
SAME_POSE = 0.02
"""Distance of the joint positions up to which two runs hold the same pose [rad or m]."""
SAME_SIGNAL = 0.8
"""Correlation of the drives' signals from which two runs play the same noise: other noise has
none, a closed loop repeats its torque nearly."""
LEAST_LINE_POWER = 0.02
"""Power of a line's command over that of the strongest part of the band; weaker lines are dropped:
their coherence is poor."""
LOWEST_HZ = 2.0
"""Lowest line used [Hz]: gravity and friction dominate slower motion."""
HIGHEST_LINE = 0.45
"""Highest line used [sampling rates]: anti-aliasing filters need the rest."""
LOWEST_PATH_LINE = 0.5
"""Lowest line of a seat's path over the lowest excited line: a seat drifts below the band."""
POSITION_INFORMATION = 0.1
"""Information of a position channel over that of the same joint's velocity, below which it is not
used."""

# Bandwidth of sensors
STOPBAND_START = 1.5
"""Frequency over the bandwidth in question, from which its stopband begins."""
STOPBAND_POWER = 0.001
"""Power in the stopband over the least in the passband, below which a channel is band-limited:
white noise does not fall."""
STOPBAND_POWER_AT_EDGE = 0.0001
"""The same beside an accelerometer at the edge of the excited band, where motion falls too."""

# Inference
UNEXPLAINED = 0.004
"""Probability kept for causes outside the hypotheses [probability]."""
HIGHEST_CERTAINTY = 0.995
"""Largest probability a user may ask for [probability]: 1 less `UNEXPLAINED`, rounded."""
LEAST_RUNS = 2
"""Runs before a case is settled: neighbouring links can be confused in one pose."""
LEAST_TESTED = 0.5
"""Share of all faults whose seats the runs have to open before an arm is called healthy [1]: what
stayed shut was not tested."""
PROBABLE = 0.6
"""Probability from which the report calls an unsettled fault probable [probability]."""
MENTIONED = 0.02
"""Probability below which a plan does not mention a hypothesis [probability]."""
REFINED_WITHIN = 60.0
"""Log-evidence behind the best first fit, up to which a hypothesis is fitted from more starts."""
OPEN_SEAT_SHARE = 0.03
"""Motion of a seat over that of a floating one, from which it is open: tight ones give less."""
OPENING_FORCE = 0.6
"""Rms force over static load at which a seat begins to open: peaks open it, not the rms."""
AVERAGED_DIRECTION_SD = 0.15
"""Standard deviation of a direction, from which it is averaged over all directions [rad]: the
Laplace approximation fails there."""
CONE_95 = 2.45
"""Half opening of a 95 % cone [standard deviations]: Rayleigh distribution."""
WIDEST_CONE_DEG = 60.0
"""Half opening of the cone, above which no direction is given [deg]."""
DIRECTION_SD_DEG = 0.7
"""Smallest standard deviation of an identified direction [deg]: mounting and axes of real
sensors."""
DIRECTION_SD_FACTOR = 2.0
"""Standard deviation of a direction over that by the curvature of the likelihood, which lacks the
errors outside the model."""

PARAMETER_TAIL = 2.0
"""Error of a model's parameter from which its prior falls exponentially only [standard deviations]:
tolerances are guesses."""

# Elasticity of gears, links and base: priors of their stiffness
GEAR_HZ = 200.0
"""Mode of the arm beyond a gear on that gear's spring, median of the prior [Hz]: arms have modes
from 20 Hz to 1 kHz."""
BENDING_HZ = 300.0
"""The same of a link's bending and of the base [Hz]."""
STIFFNESS_SD = 1.5
"""Standard deviation of a stiffness' logarithm [1]: a factor of two in the mode."""
RIGID_SD = 2.0
"""Stiffness above the median at which fits start [standard deviations]: modes of 900 Hz and more,
rigid in the usual bands, come down to where the runs show them; from below they would have to pass
one another."""
ELASTIC_LOSS = 0.05
"""Loss factor of these springs [1]: a damping ratio of 2.5 %."""

# Model error: scales of the half-Cauchy priors of what a model cannot have
DRIVE_SD = 0.2
"""Motion of a joint beside the model over that by the model: friction, servo gains, saturation."""
COMPLIANCE_HZ = 100.0
"""Frequency at which the compliances below are stated [Hz]: the motion of an elastic connection
over that of a floating one rises as frequency squared."""
GEAR_TURN_SD = 0.1
"""Turn between a joint's sensor and its link over that of a floating link: gears of a mode near
300 Hz."""
BENDING_SD = 0.03
"""Bending of a link at its seat over that of a floating link: a mode near 600 Hz."""
SEAT_SLIDE_SD = 0.01
"""Slide of a link at its tight seat over that of a floating link: a mode near 1 kHz."""
READING_SD = 0.01
"""Error of a reading over its motion: what no component of the arm explains."""
BAND_SHAPE = 2.0
"""Shape of the inverse-gamma prior of an error's factor in a band: four degrees of freedom of
Student's t."""
DRIVE_CHANGE_SD = 0.02
"""Change of that error between a run and the same run of the healthy arm: friction
varies with temperature."""
GEAR_TURN_CHANGE_SD = 0.02
"""The same of the turn: the gear is the same one, within a fifth."""
BENDING_CHANGE_SD = 0.006
"""The same of the bending."""
SEAT_SLIDE_CHANGE_SD = 0.002
"""The same of the slide."""
READING_CHANGE_SD = 0.01
"""The same of the readings, never less: temperature, cables and poses that are repeated to within
some milliradians change the motion of a healthy arm by as much."""
CLOCK_Z = 4.0
"""z-score from which a clock offset is corrected and reported."""
LARGEST_CLOCK_OFFSET_S = 0.02
"""Largest clock offset looked for [s]: half a period of a low band, beyond which peaks recur."""
CLOCK_NOTED_S = 0.001
"""Clock offset from which a verdict is not settled [s]: at 50 Hz it turns the phase by 18
degrees."""
SERVO_DELAY_NOTED_S = 0.0005
"""Delay of a joint's motion against the model's from which the reader is told [s]."""
CORRELATION_HZ = 12.0
"""Width over which model errors are alike [Hz]: lines closer than that count as one."""
MISMATCH = 0.2
"""Misfit above which the model is not that of the arm: a location it names may be wrong."""
FAULT_EFFECT = 0.03
"""Motion of the tool by the seat over all of its motion [1], which two runs have to reach before a
fault is settled: an error of 5 mrad of the poses changes as much."""
SETTLED_CONE_DEG = 30.0
"""Half opening of the direction's cone above which a fault is not settled [deg]."""
COARSENED_RUNS = 1.0
"""Runs whose evidence more runs approach: errors outside the model are alike in all of them
(coarsened posterior; Miller and Dunson, JASA 114, 2019). On simulated machines they move log
evidences of six runs by about 15, which then are odds of nine."""

# Free travel
TIME_AT_STOP = 0.02
"""Share of the time at each stop: both have to be reached before a clearance is given."""
CLEARANCE_RESIDUAL = 0.75
"""Residual of the force with a clearance over that with a spring: above, a compliant part explains
it as well."""
CLEARANCE_ERROR = 0.15
"""Relative standard deviation of a clearance: motion below the band, and compliance of the
stops."""

# Warnings
SHORT_RUN_S = 1.0
"""Length below which a run is called short [s]."""
FEWEST_LINES = 24
"""Excited lines below which the band of a run is called narrow."""
OPENING_PROBABILITY = 0.3
"""Probability of opening, mean over directions, below which a seat counts as not excited
[probability]."""
PRESSED_FORCE = 3.0
"""Static load over driving force from which gravity is said to keep a seat shut."""
MODEL_ERROR = 0.06
"""Relative model error at a line, above which the model is not that of the arm."""
MOTION_ERROR = 0.5
"""Relative error of the excited joints' motion above which the same is said: friction and servo
gains explain less."""
PARAMETER_ERROR = 4.0
"""Largest error of a parameter [standard deviations], above which the same is said: chance does not
make it once in 10,000 models."""
TOOL_SIGNAL = 10.0
"""Power of the accelerometer over its noise, below which the reader is told."""
JOINT_SIGNAL = 4.0
"""The same of the sensors of an excited joint."""
RATE_SHARE = 0.98
"""Share of the wanted sampling rate, below which the next run is planned for the recorder's own
rate."""

# Change since earlier sessions
LEAST_SESSIONS = 2
"""Earlier sessions before a series has a scatter."""
SAME_POSE = 0.02
"""Distance of each joint's position, up to which two runs are of one pose [rad or m]."""
SAME_DRIVE = 1.25
"""Ratio of the rms driving forces, up to which two runs are of one signal: friction and stops
depend on the level."""
SAME_BAND = 0.1
"""Relative distance of the ends of the excited bands, up to which two runs are of one signal."""
TREND_BANDS = 4
"""Bands in which a transmission is followed: a changed mode raises one and lowers the next."""
ODDS_SCATTER = 2.0
"""Smallest standard deviation of the log odds of a fault on a healthy arm: the probability of a
settled case varies by a factor of seven with the model's errors."""

# Planning
DETECTABLE_Z = 4.0
"""z-score from which a change of a record counts as detectable."""
FLOATING_CLEARANCE = 4.0
"""Clearance over rms travel from which a seat does not reach its stops."""
REPEATABILITY = 0.005
"""Difference between records of a healthy arm beside noise, over the tool's motion: poses that are
not quite the same, temperature, cables; an estimate."""
FOUND_YES = 0.9
"""Share of slide directions with a detectable change, from which a fault is found: yes."""
FOUND_MOSTLY = 0.3
"""The same for a fault that is mostly found; below, hardly, or not at all if no clearance is
detectable along half of the directions."""
OPEN_SHARE = 0.3
"""Share of a seat's motion that gravity has to leave free for the seat to count as open."""
PLANNED_SD_DEG = 3.0
"""Standard deviation of a direction after the records that the inspection asks for [deg]."""
TRANSVERSE_POWER = 0.03
"""Power of a rattling seat's motion across its direction over that along it."""
EQUALLY_INFORMATIVE = 0.9
"""Share of the highest expected information, from which the pose of least motion is taken."""
HOLDING_TORQUE = 0.8
"""Share of the allowed torque that holding a pose may take: the rest excites."""
HIGHEST_BAND = 0.4
"""Highest end of an excited band [sampling rates]: anti-aliasing filters need the rest."""
SCALED_LEVEL = 0.99
"""Share of the level that limits leave, below which the reader is told."""
NOTED_SAG_DEG = 0.1
"""Sag of a revolute joint under the arm's weight, above which the reader is told [deg]."""
NOTED_SAG_M = 0.0001
"""The same of a prismatic joint [m]."""
ASSUMED_SPEED = 3.14
"""Speed limit of a revolute joint of which none is stated [rad/s]: half a turn a second, common for
arms of up to 10 kg; few are slower."""
ASSUMED_SLIDE_SPEED = 1.0
"""The same of a prismatic joint [m/s]."""
TRANSIT_SHARE = 0.3
"""Share of the limits that the move to a pose takes: nobody has seen this path yet."""
TRANSIT_RISE_S = 1.0
"""Time over which the move's speed rises where no acceleration limit is known [s]."""
LEAST_LEVEL = 0.5
"""Share of the level of a diagnosis's proposal that limits have to leave for it to be planned: at
less another pose or joint may tell more."""
BAND_GAIN = 1.1
"""Factor by which a narrower band has to improve the mean detectability to replace the arm's."""
ALWAYS_TOUCHING = 0.9
"""Share of random poses in which two shapes touch, from which they do so by construction."""
GROUND_TOLERANCE_M = 0.005
"""Depth below the ground up to which a point counts as above: rounding of the model [m]."""
