"""Wrappers of a single environment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.wrappers import changes
from loose_env.wrappers.shells import DiagnosisWrapper


class MeasuredMinusNominal(changes.MeasuredMinusNominal, DiagnosisWrapper):
    """Shows statistics less what the nominal, healthy arm would show.

    Every element with a nominal twin becomes the difference of the two, each scaled as the
    observation has it; the twin is left out. What has none, pose and excitation, stays.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = MeasuredMinusNominal(gymnasium.make("loose_env/Vera-v0"))
    >>> env.observation_space.shape, env.layout.slot_elements[-1].name
    ((464,), 'lowest_kurtosis')
    """


class JointSideObservation(changes.JointSideObservation, DiagnosisWrapper):
    """Shows what torque and encoders give: a robot without accelerometers (thesis, 2.2.2).

    Left are the pose, what has been spent, and of every record its pose, excitation, joint
    motion and apparent inertia, measured and nominal. That a seat is loose shows there nearly as
    well as at the tool; its direction does not.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = gymnasium.make("loose_env/Planar-v0", n_links=2)
    >>> whole, alone = env.observation_space.shape[0], JointSideObservation(env)
    >>> alone.observation_space.shape[0] < whole / 2
    True
    """


class PosteriorObservation(changes.PosteriorObservation, DiagnosisWrapper):
    """Shows the posterior over the hypotheses in place of the records.

    A plain Gymnasium wrapper: any library can train on it. The observation is that of
    `posterior_features`; `info["probabilities"]` has the posterior itself, in the order of the
    environment's `hypotheses`.

    Parameters
    ----------
    env : gymnasium.Env
        The environment; records are read from its full observation, so put this wrapper first.
    posterior : Posterior, optional
        What weighs the records: by default the analytic posterior, from the nominal arm alone.

    Raises
    ------
    InvalidSetting
        If the observation is another one already, or the posterior lacks a hypothesis.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = PosteriorObservation(gymnasium.make("loose_env/Vera-v0"))
    >>> observation, info = env.reset(seed=0)
    >>> observation.shape, info["probabilities"].round(2).tolist()
    ((21,), [0.33, 0.17, 0.17, 0.17, 0.17])
    """

    @property
    def probabilities(self) -> NDArray[np.float64]:
        """Posterior of the environment's hypotheses (hypotheses,)."""
        return np.array(self._shares[0])


class MacroActions(changes.MacroActions, DiagnosisWrapper):
    """A `Discrete` choice among whole records, then among the verdicts.

    Choice k below ``len(macros)`` takes that record, the next ones give the environment's
    `verdicts` in their order. `action_masks` says which records stay within the joints' ranges
    and which verdicts count; a record without excitation is not among the choices.

    Parameters
    ----------
    env : gymnasium.Env
        The environment.
    macros : sequence of ndarray, optional
        Records as actions of the environment, such as its ``actions.encode`` gives;
        `default_macros` by default.

    Raises
    ------
    InvalidSetting
        If there is none, or one gives a verdict or excites nothing.
    InvalidAction
        If one is no action of the environment.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = MacroActions(gymnasium.make("loose_env/Vera-v0"))
    >>> env.action_space
    Discrete(21)
    """
