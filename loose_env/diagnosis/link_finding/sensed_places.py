"""Places held against the tool and accelerometers on links together: the local method (7.1.3).

With an accelerometer on either side of a joint the motion that is lost between the two is seen
where it is lost. A loose seat moves all sensors beyond it by one vector and none before it, so a
single record names the link, and no joint has to be moved for it.
"""

from __future__ import annotations

import numpy as np

from loose_env.arms import LinearArm, Mismatch
from loose_env.diagnosis.link_finding.pooled_scatter import (
    PlaceDirections,
    RecordScatter,
    scatter_of,
)
from loose_env.diagnosis.records.link_readings import LinkReadings, sensed_arms
from loose_env.diagnosis.records.record_statistics import RecordStatistics
from loose_env.errors import InvalidSetting
from loose_env.sensors import SensorSuite

__all__ = ["SensedPlaces"]


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
        changes = [self._at_tool(record)]
        read = zip(self._links, links.transmission_by_instrument, strict=True)
        changes += [one.change_at(record, b[:, on]) for one, b in read]
        sampling = self.sampling(record, [self.features, *self._links])
        return scatter_of(changes, len(on), sampling=sampling)
