"""What one measurement says: pure functions of arrays.

An excitation signal x has shape (N,) or (m, N) for m excited joints, a tool acceleration a has
shape (d, N) in the tool frame, d = 2 or 3; the last axis is time and means are removed inside.
Functions ending in `_from` take covariances computed once by `covariances`.
"""

from loose_env.statistics.angles import (
    axial_angle,
    axial_difference,
    axial_mean,
    axial_vector,
    wrap_axial,
)
from loose_env.statistics.coherence import (
    LowestCoherence,
    RankTest,
    lowest_coherence_direction,
    lowest_coherence_direction_from,
    rank_test,
    rank_test_from,
)
from loose_env.statistics.confidence import DirectionInterval
from loose_env.statistics.correlation import (
    MaximumCorrelation,
    correlation_along,
    correlation_along_from,
    correlation_loop,
    correlation_loop_from,
    lowest_correlation_direction,
    lowest_correlation_direction_from,
    lowest_correlation_search,
    maximum_correlation,
    maximum_correlation_from,
)
from loose_env.statistics.covariance import (
    Covariances,
    RecordCovariances,
    covariances,
    record_covariances,
)
from loose_env.statistics.effective_samples import effective_samples
from loose_env.statistics.index import ComparativeIndex, comparative_index
from loose_env.statistics.intervals import change_direction_interval, direction_interval
from loose_env.statistics.moments import (
    DirectionalMoments,
    kurtosis,
    moments_by_direction,
    shape_of,
    skewness,
)
from loose_env.statistics.planning import direction_sd, record_length_for
from loose_env.statistics.spectra import (
    TransferFunction,
    acceleration_from_angle,
    bandpass,
    spectral_flatness,
    transfer_function,
)
from loose_env.statistics.transmission import (
    TransmissionChange,
    apparent_inertia,
    apparent_inertia_from,
    transmission,
    transmission_by_instrument,
    transmission_by_instrument_from,
    transmission_change,
    transmission_from,
)

__all__ = [
    "ComparativeIndex",
    "Covariances",
    "DirectionInterval",
    "DirectionalMoments",
    "LowestCoherence",
    "MaximumCorrelation",
    "RankTest",
    "RecordCovariances",
    "TransferFunction",
    "TransmissionChange",
    "acceleration_from_angle",
    "apparent_inertia",
    "apparent_inertia_from",
    "axial_angle",
    "axial_difference",
    "axial_mean",
    "axial_vector",
    "bandpass",
    "change_direction_interval",
    "comparative_index",
    "correlation_along",
    "correlation_along_from",
    "correlation_loop",
    "correlation_loop_from",
    "covariances",
    "direction_interval",
    "direction_sd",
    "effective_samples",
    "kurtosis",
    "lowest_coherence_direction",
    "lowest_coherence_direction_from",
    "lowest_correlation_direction",
    "lowest_correlation_direction_from",
    "lowest_correlation_search",
    "maximum_correlation",
    "maximum_correlation_from",
    "moments_by_direction",
    "rank_test",
    "rank_test_from",
    "record_covariances",
    "record_length_for",
    "shape_of",
    "skewness",
    "spectral_flatness",
    "transfer_function",
    "transmission",
    "transmission_by_instrument",
    "transmission_by_instrument_from",
    "transmission_change",
    "transmission_from",
    "wrap_axial",
]
