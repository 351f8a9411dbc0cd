"""The nominal arm as an MJCF file, written as text."""

from __future__ import annotations

from scripts.suites.gap.simulator.arms import Figures

TIME_STEP = 5e-4
"""Time step of the model [s]: with the Runge-Kutta method its own error is about 1e-8 rad."""


def _text(values: object) -> str:
    return " ".join(f"{value:.10g}" for value in values)  # type: ignore[attr-defined]


def joint_names(figures: Figures) -> list[str]:
    """Names of the joints in the model."""
    return [f"joint{i + 1}" for i in range(figures.joints)]


def model_xml(figures: Figures, *, drives: bool = True) -> str:
    """MJCF of the nominal arm.

    Parameters
    ----------
    figures : Figures
        The arm.
    drives : bool
        Whether the model has its position servos; the model of a free response has none.
    """
    lines = [
        '<mujoco model="arm">',
        '  <compiler angle="radian" autolimits="true"/>',
        f'  <option timestep="{TIME_STEP:g}" integrator="RK4" gravity="0 0 -9.81"/>',
        "  <worldbody>",
    ]
    indent = "    "
    for i, link in enumerate(figures.links):
        lines += [
            f'{indent}<body name="link{i + 1}" pos="{_text(link.offset)}">',
            f'{indent}  <inertial mass="{link.mass:.10g}" pos="{_text(link.com)}" '
            f'diaginertia="{_text(link.inertia)}"/>',
            f'{indent}  <joint name="joint{i + 1}" type="{link.kind}" axis="{_text(link.axis)}" '
            f'damping="{link.damping:.10g}" armature="{link.armature:.10g}"/>',
        ]
        indent += "  "
    lines.append(f'{indent}<site name="tool" pos="{_text(figures.links[-1].end)}"/>')
    for _ in figures.links:
        indent = indent[:-2]
        lines.append(f"{indent}</body>")
    lines.append("  </worldbody>")
    if drives:
        lines.append("  <actuator>")
        lines += [
            f'    <position name="motor{i + 1}" joint="joint{i + 1}" kp="{link.kp:.10g}" '
            f'kv="{link.kv:.10g}" forcerange="{-link.limit:.10g} {link.limit:.10g}"/>'
            for i, link in enumerate(figures.links)
        ]
        lines.append("  </actuator>")
    lines.append("  <sensor>")
    for name in joint_names(figures):
        lines.append(f'    <jointpos name="{name}_pos" joint="{name}"/>')
        lines.append(f'    <jointvel name="{name}_vel" joint="{name}"/>')
    lines += ['    <accelerometer name="tool_acc" site="tool"/>', "  </sensor>", "</mujoco>", ""]
    return "\n".join(lines)
