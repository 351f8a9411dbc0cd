"""Statistics of one record: pure functions of arrays.

Data flow: _checks -> spectra -> transmission -> correlation; gaussian_mixture, impacts.
"""

from loose_env.statistics.correlation import (
    ComparativeIndex,
    LowestCoherence,
    axes_grid,
    axial_difference,
    axial_mean,
    axial_vector,
    comparative_index,
    lowest_coherence_direction_from,
    wrap_axial,
)
from loose_env.statistics.gaussian_mixture import (
    GaussianMixture,
    fit_gaussian_mixture,
)
from loose_env.statistics.impacts import knocks, rung
from loose_env.statistics.spectra import (
    PhaseDelay,
    acceleration_from_angle,
    bandpass,
    channel_floor,
    long_run_variance,
    noise_floor,
    phase_delay,
    resolution_of,
)
from loose_env.statistics.transmission import (
    Covariances,
    RecordCovariances,
    apparent_inertia_from,
    central_moments,
    covariances,
    record_covariances,
    shape_of,
    transmission_by_instrument_from,
    transmission_from,
)

__all__ = [
    "ComparativeIndex",
    "Covariances",
    "GaussianMixture",
    "LowestCoherence",
    "PhaseDelay",
    "RecordCovariances",
    "acceleration_from_angle",
    "apparent_inertia_from",
    "axes_grid",
    "axial_difference",
    "axial_mean",
    "axial_vector",
    "bandpass",
    "central_moments",
    "channel_floor",
    "comparative_index",
    "covariances",
    "fit_gaussian_mixture",
    "knocks",
    "long_run_variance",
    "lowest_coherence_direction_from",
    "noise_floor",
    "phase_delay",
    "record_covariances",
    "resolution_of",
    "rung",
    "shape_of",
    "transmission_by_instrument_from",
    "transmission_from",
    "wrap_axial",
]
