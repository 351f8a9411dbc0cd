"""Places held against the tool and accelerometers on links together: the local method (7.1.3).

With an accelerometer on either side of a joint the motion that is lost between the two is seen
where it is lost. A loose seat moves all sensors beyond it by one vector and none before it, so a
single record names the link, and no joint has to be moved for it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm, Mismatch
from loose_env.diagnosis.learned.transmission_change import TransmissionChange
from loose_env.diagnosis.link_finding.pooled_scatter import (
    SECOND_ORDER,
    PlaceDirections,
    RecordScatter,
    scatter_of,
)
from loose_env.diagnosis.records.link_readings import LinkReadings, sensed_arms
from loose_env.diagnosis.records.record_statistics import RecordStatistics
from loose_env.errors import InvalidSetting
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

__all__ = ["SensedPlaces"]

_BENDING = 0.08
"""Error beyond the first order on an arm that bends in the band, over the rms nominal motion [1]:
what springs do to its modes shows at every sensor by another amount. With the 2 % of stiff arms
most healthy ones look loose on VERA."""


class SensedPlaces(PlaceDirections):
    """Holds records of tool and link accelerometers against the places of an arm.

    Places are those of `PlaceDirections`.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    sensors : SensorSuite
        Parameters of the sensors, accelerometers on links among them.
    mismatch : Mismatch
        Errors of the nominal model.

    Raises
    ------
    InvalidSetting
        If there are no accelerometers on links, or they measure one axis only.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> suite = SensorSuite(link_accelerometers=True)
    >>> SensedPlaces(LinearArm(planar(2)), suite, Mismatch()).names[0]
    'structural_looseness@link1'
    """

    def __init__(self, linear: LinearArm, sensors: SensorSuite, mismatch: Mismatch) -> None:
        super().__init__(linear, sensors, mismatch)
        choice = sensors.on_links
        if choice is None:
            raise InvalidSetting(
                "the local method needs accelerometers on links and the sensors have none; set "
                "link_accelerometers=True in SensorSuite"
            )
        if choice.tangential:
            raise InvalidSetting(
                "the local method needs all axes of the accelerometers on links, and tangential "
                "ones measure one; set tangential=False"
            )
        arms = sensed_arms(linear.arm, choice)
        self._links = [self.features.sensed_at(arm) for arm in arms]

    def with_links(self, record: RecordStatistics, links: LinkReadings) -> RecordScatter:
        """Hold one record of all sensors against all places."""
        on = np.flatnonzero(record.excited)
        changes = [self.features.with_change(record)[2]]
        read = zip(self._links, links.transmission_by_instrument, links.rms, strict=True)
        changes += [one.change_at(record, b[:, on], rms) for one, b, rms in read]
        order = _BENDING if self.features.bends else SECOND_ORDER
        sampling = self._sampling(record, on, changes[0])
        return scatter_of(changes, len(on), sampling=sampling, second_order=order)

    def _sampling(
        self, record: RecordStatistics, on: NDArray[np.intp], at_tool: TransmissionChange
    ) -> Array:
        """Covariance of the sampling errors of all sensors' axes, per command (D, D) [m²/s⁴].

        A record of finite length errs by the motion out of step with the commands. That is the
        arm's, much the same at all sensors, so it is predicted for all of them together, at the
        size that the tool shows: rms less predicted motion in step is a difference of two large
        numbers, by chance often below zero.
        """
        sensors = [self.features, *self._links]
        answers = [one.linear.at(record.pose).response(record.excited) for one in sensors]
        tool = np.concatenate([answer.tool for answer in answers], axis=1)  # (K, D, m)
        joint = answers[0].joint[:, on]
        b = np.linalg.solve(joint.real.mean(axis=0).T, tool.real.mean(axis=0).T).T
        rest = (tool - b @ joint) * record.torque[on]
        power = np.einsum("kim,kjm->ij", rest, rest.conj()).real / len(rest)
        power += self.features.floor.tool**2 * np.eye(len(power))
        power /= self.features.samples(record.duration)
        assert at_tool.residual is not None
        d = len(at_tool.residual)
        larger = float(np.trace(at_tool.residual) / np.trace(power[:d, :d]))
        return np.asarray(max(larger, 1.0) * power)
