"""Statistics of one record: pure functions of arrays.

Data flow: _checks -> directions -> gaussian_mixture -> moments -> correlation ->
spectra -> transmission.
"""

from loose_env.statistics.correlation import (
    ComparativeIndex,
    LowestCoherence,
    comparative_index,
    correlation_loop,
    correlation_loop_from,
    lowest_coherence_direction_from,
    lowest_correlation_direction,
    maximum_correlation,
)
from loose_env.statistics.directions import (
    axes_grid,
    axial_angle,
    axial_difference,
    axial_mean,
    axial_vector,
    tangents,
    wrap_axial,
)
from loose_env.statistics.gaussian_mixture import (
    GaussianMixture,
    fit_gaussian_mixture,
)
from loose_env.statistics.moments import (
    Covariances,
    covariances,
    kurtosis,
    record_covariances,
    shape_of,
    skewness,
)
from loose_env.statistics.spectra import (
    PhaseDelay,
    acceleration_from_angle,
    bandpass,
    channel_floor,
    long_run_variance,
    noise_floor,
    phase_delay,
    resolution_of,
    transfer_function,
)
from loose_env.statistics.transmission import (
    apparent_inertia_from,
    transmission,
    transmission_by_instrument_from,
    transmission_from,
)

__all__ = [
    "ComparativeIndex",
    "Covariances",
    "GaussianMixture",
    "LowestCoherence",
    "PhaseDelay",
    "acceleration_from_angle",
    "apparent_inertia_from",
    "axes_grid",
    "axial_angle",
    "axial_difference",
    "axial_mean",
    "axial_vector",
    "bandpass",
    "channel_floor",
    "comparative_index",
    "correlation_loop",
    "correlation_loop_from",
    "covariances",
    "fit_gaussian_mixture",
    "kurtosis",
    "long_run_variance",
    "lowest_coherence_direction_from",
    "lowest_correlation_direction",
    "maximum_correlation",
    "noise_floor",
    "phase_delay",
    "record_covariances",
    "resolution_of",
    "shape_of",
    "skewness",
    "tangents",
    "transfer_function",
    "transmission",
    "transmission_by_instrument_from",
    "transmission_from",
    "wrap_axial",
]
