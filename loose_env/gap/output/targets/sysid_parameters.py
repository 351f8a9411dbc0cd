"""Export of identified effects as a ``ParameterDict`` of ``mujoco.sysid``, Python and YAML.

``parameters.py`` builds the dictionary with a modifier for each parameter that is one attribute of
MJCF; ``parameters.yaml`` has the same values in the form that ``ParameterDict.load_from_disk``
reads. Classes and their arguments are those of ``mujoco.sysid`` in MuJoCo 4.0: ``Parameter(name,
nominal, min_value, max_value, frozen, modifier)``, whose modifier is called with the spec and the
parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np

from loose_env.gap.output.targets.model_parameters import ModelParameter, model_parameters
from loose_env.gap.output.targets.source import Export, ExportSource
from loose_env.io import json_text, plain

_HEAD = '''"""Effects identified by 'loose gap' as parameters of mujoco.sysid.

    import mujoco
    from parameters import parameters

    spec = mujoco.MjSpec.from_file("model.xml")  # the corrected model beside result.json
    found = parameters()

Bounds are 95 % intervals, nominal is the value of the nominal model. A frozen parameter has no
modifier: model.xml contains its effect, which is no single attribute of MJCF.
{listed}"""

from collections.abc import Callable

import mujoco
import numpy as np
from mujoco import sysid

Modifier = Callable[[mujoco.MjSpec, sysid.Parameter], None]


def _sets(element: str, name: str, attribute: str, index: int | None = None) -> Modifier:
    """Modifier that sets an attribute of an element."""

    def modify(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        found = getattr(spec, element)(name)
        value = float(parameter.value[0])
        if index is not None:
            whole = np.array(getattr(found, attribute))
            whole[index] = value
            setattr(found, attribute, whole)
        else:
            setattr(found, attribute, value)
            if attribute == "delay":  # its history covers twice the delay
                needed = 2 * int(np.ceil(value / spec.option.timestep)) + 2
                found.nsample = max(int(found.nsample), needed)

    return modify


def _scales(name: str, nominal: dict[str, list[float]]) -> Modifier:
    """Modifier that multiplies attributes of an actuator."""

    def modify(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        for attribute, value in nominal.items():
            setattr(spec.actuator(name), attribute, float(parameter.value[0]) * np.array(value))

    return modify


def parameters() -> sysid.ParameterDict:
    """Return the parameters, at their identified values."""
    found = sysid.ParameterDict()
'''
_TAIL = """    return found
"""


def sysid_export(source: ExportSource) -> Export:
    """Write the parameters of the named effects for ``mujoco.sysid``."""
    found = model_parameters(source)
    states = {p.name: _state(p) for p in found}
    left = tuple(
        f"{p.name} {p.value:.4g} {p.unit}".rstrip()
        + (
            " has no modifier and is frozen; "
            + (
                "model.xml contains it"
                if p.effect.in_model
                else "the code in result.json applies it"
            )
        )
        for p in found
        if not p.attribute
    )
    # JSON is YAML, which needs a package to be written
    return Export(
        files={
            "parameters.py": _HEAD.format(listed=_listed(left))
            + "".join(_added(source, p, states[p.name]) for p in found)
            + _TAIL,
            "parameters.yaml": json_text(states),
        },
        not_expressed=left,
        notes=("the parameters apply to model.xml beside result.json",),
    )


def _listed(left: Sequence[str]) -> str:
    return "".join(f"\n- {words}" for words in left) + ("\n" if left else "")


def _state(p: ModelParameter) -> dict[str, object]:
    """Return a parameter in the form of ``ParameterDict.save_to_disk``."""
    nominal = p.nominal if isfinite(p.nominal) else p.value
    state: dict[str, object] = plain(
        {
            "name": p.name,
            "nominal": [nominal],
            "min_value": [p.low],
            "max_value": [p.high],
            "value": [p.value],
            "frozen": not p.attribute or not p.low < p.high,
        }
    )
    return state


def _added(source: ExportSource, p: ModelParameter, state: dict[str, object]) -> str:
    """Lines that add one parameter."""
    lines = [
        "    found.add(",
        "        sysid.Parameter(",
        f"            {p.name!r},{f'  # {p.unit}' if p.unit else ''}",
        f"            nominal={state['nominal']},",
        f"            min_value={state['min_value']},",
        f"            max_value={state['max_value']},",
        f"            frozen={state['frozen']},",
    ]
    if p.scales:
        lines.append(f"            modifier=_scales({p.where!r}, {_scaled(source, p)}),")
    elif p.attribute:
        index = "" if p.index is None else f", {p.index}"
        lines.append(
            f"            modifier=_sets({p.element!r}, {p.where!r}, {p.attribute!r}{index}),"
        )
    lines += [
        "        )",
        "    )",
        f"    found[{p.name!r}].update_from_vector(np.array({state['value']}))",
    ]
    return "\n".join(lines) + "\n"


def _scaled(source: ExportSource, p: ModelParameter) -> dict[str, list[float]]:
    """Attributes of an actuator that its gain scales, with their nominal values."""
    actuator = source.model.actuator(p.where)
    attributes = {"gainprm": actuator.gainprm}
    if p.effect.variant != "command":
        attributes["biasprm"] = actuator.biasprm
    if not p.effect.variant and actuator.forcelimited[0]:
        attributes["forcerange"] = actuator.forcerange
    whole = {a: (np.asarray(v, dtype=float) / p.value).tolist() for a, v in attributes.items()}
    nominal: dict[str, list[float]] = plain(whole)
    return nominal
