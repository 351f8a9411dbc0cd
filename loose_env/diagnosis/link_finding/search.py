"""Link search of the thesis in space: candidate links after each move of a joint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loose_env.diagnosis.link_finding.direction_images import ToolFrames
from loose_env.diagnosis.link_finding.moves import blind_joints, next_seeing_joint
from loose_env.diagnosis.link_finding.planar import LinkFindingSettings
from loose_env.diagnosis.link_finding.spatial import DirectionSighting, judge_turn_in_space
from loose_env.errors import InvalidData
from loose_env.typing import Array

__all__ = ["TurnSearch"]


@dataclass(frozen=True, kw_only=True)
class TurnSearch:
    """Links in question: low..high. Each judged move gives a new search.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> frames = ToolFrames(planar(3))
    >>> search = TurnSearch.over(3)
    >>> poses = np.array([[0.0, 0.4, 0.1], [0.0, 1.9, 0.1]])
    >>> seen = frames.images(poses)[:, 1] @ [0.6, 0.8]  # a slide at link 2
    >>> before, after = (DirectionSighting.of(q, p, 0.05) for q, p in zip(poses, seen))
    >>> found = search.after(frames, before, after, joint=2, rules=LinkFindingSettings())
    >>> found.low, found.high
    (2, 3)
    """

    low: int
    """Lowest link in question."""
    high: int
    """Highest link in question."""
    tries: int = 0
    """Moves of the present joint that decided nothing."""

    @classmethod
    def over(cls, links: int) -> TurnSearch:
        """Begin with every link of an arm in question."""
        return cls(low=1, high=links)

    def joint(
        self,
        frames: ToolFrames,
        seen: DirectionSighting,
        *,
        moves: Array,
        rules: LinkFindingSettings,
        can_move: NDArray[np.bool_] | None = None,
    ) -> int | None:
        """Joint to move next from where a direction was seen; None if nothing is left to do.

        Joints that cannot turn the direction are passed over. Where only those are left, the
        links in question cannot be told apart from this pose.

        Parameters
        ----------
        frames : ToolFrames
            The arm's rotations.
        seen : DirectionSighting
            The latest direction.
        moves : ndarray (m,)
            Moves of a hinge [rad].
        rules : LinkFindingSettings
            Holds the order.
        can_move : ndarray of bool (n,), optional
            Joints that their ranges let move; all by default.
        """
        if self.low >= self.high:
            return None
        blind = blind_joints(frames, seen.pose, seen.direction, moves=moves)
        if can_move is not None:
            blind = blind | ~can_move
        return next_seeing_joint(rules.order, self.low, self.high, blind)

    def after(
        self,
        frames: ToolFrames,
        before: DirectionSighting,
        after: DirectionSighting,
        *,
        joint: int,
        rules: LinkFindingSettings,
        visible: bool = True,
    ) -> TurnSearch:
        """Narrow the links by what a joint's move did (steps 5 to 8 of 4.2.2).

        Parameters
        ----------
        frames : ToolFrames
            The arm's rotations.
        before, after : DirectionSighting
            Directions in two poses that differ in that joint alone.
        joint : int
            Joint that moved, from 1.
        rules : LinkFindingSettings
            Thresholds and retries of 4.31. Out of retries, the nearer threshold decides.
        visible : bool
            True if the record after the move showed a direction; if not, the move is one more try.

        Raises
        ------
        InvalidData
            If another joint has moved as well.
        """
        moved = after.pose - before.pose
        if np.abs(np.delete(moved, joint - 1)).max(initial=0.0) > 1e-6:
            raise InvalidData(
                f"a turn is judged by the move of joint {joint} alone; the poses differ by {moved}"
            )
        axis = frames.axes(after.pose)[0, joint - 1]

        def judged(settings: LinkFindingSettings) -> str:
            return judge_turn_in_space(
                before.direction,
                after.direction,
                axis=axis,
                move=float(moved[joint - 1]),
                settings=settings,
            )

        finding = judged(rules) if visible else "unclear"
        if finding == "unclear":
            if self.tries < rules.retries:
                return replace(self, tries=self.tries + 1)
            finding = judged(LinkFindingSettings(still=0.5, turned=np.finfo(float).max))
        if finding == "turned":
            return TurnSearch(low=self.low, high=max(self.low, joint - 1))
        return TurnSearch(low=min(self.high, joint), high=self.high)

    def link(self, rules: LinkFindingSettings) -> int:
        """Link to name now: the end at which the order of the search began."""
        return self.high if rules.order == "inward" else self.low
