"""Models whose bodies, sites, geoms and drives have no names lose no candidates and no mass."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.effects.inertia import Payload, payload_notes
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel, link_ends, naming_notes
from loose_env.gap.output.corrected_model import corrected_spec

NAMED = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="first">
      <joint name="turn" axis="0 0 1" damping="0.1"/>
      <geom name="g1" size=".05" pos=".2 0 0" mass="3"/>
      <camera name="eye" pos="0.3 0 0.1"/><light name="lamp" pos="0.3 0 0.2"/>
      <body name="cover" pos="0.1 0 0.05"><geom name="g2" size=".02" mass="0.3"/></body>
      <body name="second" pos=".4 0 0">
        <joint name="lift" axis="0 1 0" damping="0.1"/>
        <geom name="g3" size=".05" pos=".2 0 0" mass="1"/>
        <frame pos="0.1 0 0" euler="0 0 20">
          <site name="inside" pos="0.1 0 0" euler="10 0 0"/>
          <geom name="g4" size=".02" pos=".1 0 0" mass="0.2"/>
        </frame>
        <site name="last" pos=".4 0 0"/>
        <body name="flange" pos="0.3 0 0"><geom name="g5" size=".02" mass="0.1"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="m1" joint="turn" kp="50" kv="2"/>
    <position name="m2" joint="lift" kp="70" kv="2"/>
  </actuator>
  <sensor>
    <jointpos name="p1" joint="turn"/><jointpos name="p2" joint="lift"/>
    <jointvel name="v1" joint="turn"/>
  </sensor>
</mujoco>
"""


def bare() -> str:
    """The same model with the names only that a recording needs: joints, and sensors it has."""
    text = NAMED
    for name in (
        "first", "second", "cover", "flange", "inside", "last", "eye", "lamp", "m1", "m2", "v1",
        *(f"g{k}" for k in range(1, 6)),
    ):  # fmt: skip
        text = text.replace(f' name="{name}"', "")
    return text


def machine(text: str) -> NominalModel:
    return NominalModel(mujoco.MjSpec.from_string(text))


def test_links_without_name_are_called_after_their_joint_and_it_is_said() -> None:
    assert machine(NAMED).links == ("first", "second")
    assert machine(bare()).links == ("turn_link", "lift_link")
    (words,) = naming_notes(mujoco.MjSpec.from_string(bare()))
    assert "turn_link" in words and "lift_link" in words and "model.xml" in words
    assert naming_notes(mujoco.MjSpec.from_string(NAMED)) == []
    taken = bare().replace("<body>", '<body name="lift_link">', 1)
    assert machine(taken).links == ("lift_link", "lift_link_2")


@pytest.mark.parametrize("kind", list(CATALOGUE))
def test_effects_are_the_same_with_and_without_names(kind: str) -> None:
    named, unnamed = machine(NAMED), machine(bare())
    read = [each for each in candidates(named, [kind]) if each.where != "v1"]  # no column has it
    pairs = list(zip(read, candidates(unnamed, [kind]), strict=True))
    assert pairs or kind in ("sensor_misalignment", "base_compliance")
    for one, other in pairs:
        models = []
        for effect in (one, other):
            spec = effect.machine.fresh()
            effect.edit(spec, np.array(effect.starts[0]))
            models.append(spec.compile())
        first, second = models
        for field in (
            "body_mass", "body_pos", "dof_damping", "jnt_stiffness", "site_pos", "site_bodyid",
            "geom_pos", "geom_bodyid", "cam_bodyid", "light_bodyid", "actuator_gainprm",
        ):  # fmt: skip
            assert np.allclose(getattr(first, field), getattr(second, field)), (one, field)


SITES = (
    '<site name="last" pos=".4 0 0"/>',
    '<site name="inside" pos="0.1 0 0" euler="10 0 0"/>',
)
NO_SITES = NAMED.replace(SITES[0], "").replace(SITES[1], "")
MIDDLE = '<site name="middle"/><camera name="eye"'
NO_FLANGE = NO_SITES.replace('<body name="flange" pos="0.3 0 0">', "<frame>").replace(
    'name="g5" size=".02" mass="0.1"/></body>', 'name="g5" size=".02" mass="0.1"/></frame>'
)


@pytest.mark.parametrize(
    ("text", "body", "words"),
    [
        (NAMED, "second", ""),
        (NO_SITES, "flange", "site"),
        (NO_FLANGE, "second", "second"),
        # a site of an inner link is the tool only where there is no other
        (NAMED.replace('<camera name="eye"', MIDDLE), "second", ""),
        (NO_SITES.replace('<camera name="eye"', MIDDLE), "first", "middle"),
    ],
)
def test_a_payload_hangs_at_the_last_site_of_the_last_link_or_at_its_end_and_it_is_said(
    text: str, body: str, words: str
) -> None:
    own = machine(text)
    spec = own.fresh()
    Payload(own, "tool").edit(spec, np.array([0.5]))
    model = spec.compile()
    carrier = int(model.body("tool_payload").parentid[0])
    assert model.body(carrier).name == body
    if text == NO_FLANGE:
        assert np.allclose(model.body("tool_payload").pos, link_ends(own, "second")[1])
    elif body == "second":
        assert np.allclose(model.body("tool_payload").pos, [0.4, 0, 0])
    notes = payload_notes(own)
    assert len(notes) == bool(words) and words in "".join(notes) and (not notes or body in notes[0])


def test_the_model_that_is_written_carries_the_names() -> None:
    unnamed = machine(bare())
    effect = CATALOGUE["link_mass"](unnamed, "lift_link")
    text = corrected_spec(unnamed, Hypothesis().with_effects([(effect, np.array([0.5]))]))
    text.compile()
    model = mujoco.MjModel.from_xml_string(text.to_xml())
    assert model.body("lift_link").mass[0] == pytest.approx(1.7)


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass' is deprecated")
@pytest.mark.parametrize("option", ['inertiafromgeom="true"', 'settotalmass="9"'])
def test_an_added_mass_is_that_whatever_the_compiler_makes_of_masses(option: str) -> None:
    text = NAMED.replace("<mujoco>", f"<mujoco><compiler {option}/>")
    nominal, model = machine(text), mujoco.MjModel.from_xml_string(text)
    assert np.allclose(nominal.model.body_mass, model.body_mass)
    assert np.allclose(nominal.model.body_inertia, model.body_inertia)
    effect = CATALOGUE["link_mass"](nominal, "second")
    spec = corrected_spec(nominal, Hypothesis().with_effects([(effect, np.array([0.5]))]))
    added = 0.5 * (np.arange(model.nbody) == model.body("second").id)
    for found in (spec.compile(), mujoco.MjModel.from_xml_string(spec.to_xml())):
        assert np.allclose(found.body_mass, added + model.body_mass, rtol=1e-5)


@pytest.mark.parametrize(
    ("joint", "said"),
    [
        ('<freejoint name="loose"/>', "joint 'loose' of body 'box' is no hinge and no slide"),
        ('<joint type="ball"/>', "joint 1 of body 'box' is no hinge and no slide"),
        ("<joint/>", "needs a name; joint 1 of body 'box' has none"),
    ],
)
def test_a_joint_that_is_not_supported_is_named(joint: str, said: str) -> None:
    xml = f"""<mujoco><worldbody>
    <body name="link"><joint name="turn"/><geom size=".1" mass="1"/></body>
    <body name="box">{joint}<geom size=".1" mass="1"/></body></worldbody></mujoco>"""
    with pytest.raises(InvalidData, match=said):
        NominalModel(mujoco.MjSpec.from_string(xml))
