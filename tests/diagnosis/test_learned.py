"""The posterior with a learned likelihood: its sums, its files, and what it says."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from loose_env.arms import LinearArm, Mismatch, planar
from loose_env.diagnosis import (
    LOCATION_FEATURES,
    RECORD_FEATURES,
    AmortisedPosterior,
    SeatFeatures,
    SeatNetwork,
    read_network,
    statistics_of,
    trained_for,
    write_network,
)
from loose_env.errors import InvalidData
from loose_env.excitation import at_levels
from loose_env.faults import StructuralLooseness
from loose_env.rig import SimulatedRig
from loose_env.sensors import SensorSuite


def network(hypotheses, *, width=8, frictions=3, seed=0):
    rng = np.random.default_rng(seed)
    sizes = {
        "C": len(LOCATION_FEATURES),
        "Q": len(RECORD_FEATURES),
        "W": width,
        "H": hypotheses,
        "F": frictions,
        "R": 12,
    }
    return {
        name: np.ones([sizes[x] for x in letters], dtype=np.float32)
        if name.endswith("scale")
        else rng.normal(size=[sizes[x] for x in letters]).astype(np.float32) / 4
        for name, letters in SeatNetwork.shapes.items()
    }


def posterior(arm, **given):
    return AmortisedPosterior(
        LinearArm(arm),
        SensorSuite(),
        Mismatch(),
        SeatNetwork(network(2 * arm.n)),
        directions=6,
        **given,
    )


def record(arm, fault=None, levels=None, seed=0):
    rig = SimulatedRig(arm, threads=1)
    if fault is not None:
        rig.mount(0, fault)
    pose = arm.random_pose(np.random.default_rng(seed))
    wanted = np.array([0.0, *arm.levels])[np.full(arm.n, 3) if levels is None else levels]
    excitation = at_levels(rig.nominal.at(pose), wanted, duration=0.4)[0]
    return statistics_of(rig.measure(pose, excitation, rng=np.random.default_rng(seed)))


def test_without_records_the_prior_comes_out():
    kinds = {"healthy": 0.5, "structural_looseness": 0.2, "backlash": 0.3}
    found = posterior(planar(2), kinds=kinds).start().probabilities
    assert np.allclose(found, [0.5, 0.1, 0.1, 0.15, 0.15])


def test_order_of_records_does_not_matter_and_probabilities_sum_to_one():
    arm = planar(2)
    p = posterior(arm)
    records = [record(arm, seed=k) for k in range(3)]
    forth, back = p.start(), p.start()
    for k in range(3):
        forth, back = p.update(forth, records[k]), p.update(back, records[2 - k])
    assert np.allclose(forth.probabilities, back.probabilities)
    assert forth.probabilities.sum() == pytest.approx(1.0)
    assert forth.records == 3


def test_direction_and_friction_are_summed_out_as_written():
    arm = planar(2)
    p = posterior(arm)
    belief = p.update(p.start(), record(arm))
    weight = np.exp(belief.temper * belief.total).mean(1)  # over friction
    by_link = weight[:12].reshape(2, 6).mean(1)  # over direction
    likelihood = np.concatenate([[1.0], by_link, weight[12:]])
    prior = np.array([1 / 3, 1 / 6, 1 / 6, 1 / 6, 1 / 6])
    expected = likelihood * prior / (likelihood @ prior)
    assert np.allclose(belief.probabilities, expected)


def test_figures_show_a_wide_open_seat_at_its_place():
    arm = planar(3)
    loose = StructuralLooseness(
        link=2, direction=(0, 1, 0), gap=4e-4, stiffness=(2e4, 2e4), friction=0.0
    )
    features = SeatFeatures(LinearArm(arm), SensorSuite(), Mismatch(), directions=12)
    one = np.array([3, 0, 0])
    gained = []
    for seed in range(6):
        place, whole = features.of(record(arm, loose, one, seed))
        sound, quiet = features.of(record(arm, None, one, seed))
        true = 12 + 6  # link 2, along y: the seventh of twelve directions
        alike = place[:, LOCATION_FEATURES.index("alike")]
        assert whole[0] > quiet[0]
        assert alike[true] > 0.9
        gained.append(place[true, 1] - sound[true, 1])
    assert np.median(gained) > 1  # some poses hardly drive the seat
    assert place.shape == (3 * 12 + 3, len(LOCATION_FEATURES))
    assert whole.shape == (len(RECORD_FEATURES),)
    assert np.isfinite(place).all() and np.isfinite(whole).all()


def test_files_come_back_and_other_arms_are_refused(tmp_path):
    tensors = network(6)
    rules = trained_for(planar(3), [0.2, 0.4])
    configuration = {**rules, "directions": 6, "friction": [0.02, 1.0]}
    write_network(tmp_path, configuration, tensors)
    read, again = read_network(tmp_path)
    assert read["format"] == "loose-posterior/1"
    assert all(np.array_equal(again[name], tensors[name]) for name in tensors)
    loaded = AmortisedPosterior.load(tmp_path, LinearArm(planar(3)), SensorSuite(), Mismatch())
    one = record(planar(3))
    assert loaded.update(loaded.start(), one).probabilities.sum() == pytest.approx(1.0)
    AmortisedPosterior.load(
        tmp_path, LinearArm(planar(3)), SensorSuite(), Mismatch(), durations=[0.2]
    )
    for other, durations, words in (
        (planar(2), [], "arm 'planar3', not 'planar2'"),
        (planar(3).with_levels([1.0, 2.0]), [], "levels (1.0, 4.0, 12.0), not (1.0, 2.0)"),
        (planar(3).under_gravity([0, -9.81, 0]), [], "gravity"),
        (planar(3, hold="servo"), [], "arm 'planar3', not 'planar3-servo'"),
        (planar(3), [1.2], "durations (0.2, 0.4), not (1.2,)"),
    ):
        with pytest.raises(InvalidData, match=re.escape(f"was trained for {words}")):
            AmortisedPosterior.load(
                tmp_path, LinearArm(other), SensorSuite(), Mismatch(), durations=durations
            )
    with pytest.raises(InvalidData, match="no trained posterior"):
        read_network(tmp_path / "none")
    described = tmp_path / "configuration.json"
    described.write_text(json.dumps({**read, "format": "loose-posterior/0"}))
    with pytest.raises(InvalidData, match="format"):
        read_network(tmp_path)
    wrong = {"format": "loose-posterior/1"}
    for broken, words in (
        ([], "format"),
        (wrong, "'arm' is missing"),
        (wrong | configuration | {"directions": 0}, "directions"),
        (wrong | configuration | {"friction": [-1.0, 1.0]}, "friction"),
    ):
        described.write_text(json.dumps(broken))
        with pytest.raises(InvalidData, match=words):
            AmortisedPosterior.load(tmp_path, LinearArm(planar(3)), SensorSuite(), Mismatch())
    weights = tmp_path / "posterior.safetensors"
    weights.write_bytes(weights.read_bytes()[:500])
    with pytest.raises(InvalidData, match="cannot be read"):
        read_network(tmp_path)


def test_tensors_that_do_not_fit_are_refused():
    tensors = network(4)
    with pytest.raises(InvalidData, match="no tensor 'temper'"):
        SeatNetwork({k: v for k, v in tensors.items() if k != "temper"})
    with pytest.raises(InvalidData, match="does not fit"):
        SeatNetwork(tensors | {"out.bias": np.zeros(7, dtype=np.float32)})
    with pytest.raises(InvalidData, match="not finite"):
        SeatNetwork(tensors | {"out.bias": np.full(3, np.nan, dtype=np.float32)})
    with pytest.raises(InvalidData, match="4 faults; arm 'planar3' has"):
        AmortisedPosterior(
            LinearArm(planar(3)), SensorSuite(), Mismatch(), SeatNetwork(tensors), directions=6
        )
