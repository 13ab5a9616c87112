"""Gymnasium environments: gymnasium's own check, and a controller that holds cup, egg and ball."""

import importlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.io.bundle import Bundle, save_bundle, stamp_bundle
from phytac_design.design.design_file import to_toml
from phytac_design.simulation.run.virtual_sensor import VirtualSensor
from phytac_design.stages.virtual_sensor_stage import virtual_sensor
from phytac_design.workflows import mujoco_sensor
from tests.refusals import refused
from tests.simulation.test_mujoco_sensor import FINER, UNIT, design

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed (environments)")
pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra simulators)")
ROOT = Path(__file__).parents[2]
NAMES = ("Cup", "Egg", "Ball")


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    from phytac_design.environments.grasp_environment import designed_decoder

    return designed_decoder(design(), FINER, lambda _: None)


@pytest.fixture(scope="module")
def sensor() -> VirtualSensor:
    return virtual_sensor(design(), unit=UNIT, accuracy=FINER)


def made(name: str, bundle: Bundle, sensor: VirtualSensor) -> Any:
    importlib.import_module("phytac_design.environments")
    return gymnasium.make(f"phytac/{name}-v0", design=design(), bundle=bundle, sensor=sensor)


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_accepts_it(name: str, bundle: Bundle, sensor: VirtualSensor) -> None:
    from gymnasium.utils.env_checker import check_env

    check_env(made(name, bundle, sensor).unwrapped)


@pytest.mark.parametrize("name", ["Egg", pytest.param("Ball", marks=pytest.mark.long)])
def test_the_controller_holds_it(name: str, bundle: Bundle, sensor: VirtualSensor) -> None:
    from phytac_design.environments.grip_controller import GripController

    environment = made(name, bundle, sensor)
    thing = environment.unwrapped.thing
    controller, grips, rewards = GripController(thing=thing), [], []
    seen, _ = environment.reset(seed=4)
    done = False
    while not done:
        seen, reward, terminated, truncated, info = environment.step(controller.act(seen))
        grips.append((info["true_grip_N"], *seen["grip_N"]))
        rewards.append(reward)
        done = terminated or truncated
    assert info["outcome"] == "held"
    true, found, low, high = np.array(grips).T
    assert true.max() < thing.force_max_N
    assert rewards[-1] == 1.0
    held = slice(-20, None)
    assert np.mean((low <= true)[held] & (true <= high)[held]) >= 0.8
    assert found[held] == pytest.approx(true[held], rel=0.3)
    on = np.flatnonzero(seen["switches"])
    assert set(on) <= set(environment.unwrapped.sensor._before.koi)
    assert len(on) > 0


def test_the_guide_holds_the_cup(
    bundle: Bundle,
    sensor: VirtualSensor,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run_guide("environments", bundle, sensor, tmp_path, monkeypatch)
    assert capsys.readouterr().out.startswith("held ")


def test_the_guide_records_grasps(
    bundle: Bundle,
    sensor: VirtualSensor,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    run_guide("lerobot", bundle, sensor, tmp_path, monkeypatch)
    assert capsys.readouterr().out == "['held', 'held']\n"
    info = json.loads(Path("grasps/meta/info.json").read_text())
    assert (info["total_episodes"], info["fps"]) == (2, 30)
    rows = [
        parquet.read_table(f"grasps/data/chunk-000/file-{number:03d}.parquet").to_pylist()
        for number in range(2)
    ]
    assert len(rows[0]) + len(rows[1]) == info["total_frames"]
    last, first = rows[0][-1], rows[0][0]
    assert (last["next.done"], last["next.success"], last["next.reward"]) == (True, True, 1.0)
    assert (first["next.done"], first["observation.grip"]) == (False, [0.0, 0.0, 0.0])
    # The action of a row is the one that followed its observation: closing at the approach speed.
    assert first["action"] == pytest.approx([0.6, 0.0])
    assert 5.0 < last["observation.grip"][0] < 20.0
    assert sum(last["observation.switches"]) >= 1.0


def run_guide(
    name: str,
    bundle: Bundle,
    sensor: VirtualSensor,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Run the first program of a guide, with the sensor at hand."""
    guide = (ROOT / "docs" / "guides" / f"{name}.md").read_text(encoding="utf-8")
    code = guide.split("```python\n")[1].partition("```")[0]
    monkeypatch.chdir(folder)
    Path("mine.toml").write_text(to_toml(design()), encoding="utf-8")
    decoder = Path("exports/mine/decoder")
    save_bundle(bundle, decoder)
    stamp_bundle(decoder, design=bundle.design, design_hash=bundle.design_hash)
    monkeypatch.setattr(mujoco_sensor, "virtual_sensor", lambda *_, **__: sensor)
    exec(code, {})  # noqa: S102 - our own guide


def ended(environment: Any, closing: float, lifting: float) -> tuple[float, dict[str, Any]]:
    """The last reward, and facts, of an episode with the same action in every frame."""
    environment.reset(seed=1)
    while True:
        _, reward, terminated, truncated, info = environment.step(
            np.array([closing, lifting], dtype=np.float32)
        )
        if terminated or truncated:
            return reward, info


def test_a_blind_hand_fails(bundle: Bundle, sensor: VirtualSensor) -> None:
    environment = made("Cup", bundle, sensor)
    reward, info = ended(environment, 1.0, 0.0)
    assert (reward, info["outcome"]) == (-100.0, "crushed")
    assert info["true_grip_N"] > 12.0
    reward, info = ended(environment, 0.0, 1.0)
    assert (reward, info["outcome"]) == (-100.0, "dropped")


def test_a_light_grip_drops_a_full_cup(bundle: Bundle, sensor: VirtualSensor) -> None:
    environment = made("Cup", bundle, sensor)
    environment.reset(seed=1)
    own, outcome = environment.unwrapped, ""
    while not outcome:
        # A hand that knows the true grip: 2.5 N carry the empty cup, the full one needs 3.5 N.
        lifting = float(own.true_grip_N > 2.4 or own.gripper.moved_mm("lift") > 1.0)
        closing = 0.2 * (2.5 - own.true_grip_N) if own.true_grip_N else 1.0
        *_, info = environment.step(np.array([closing, lifting], dtype=np.float32))
        outcome = info["outcome"]
    assert outcome == "dropped"
    assert own.gripper.moved_mm("rise") > 40.0
    assert own._filled > 0.3


def test_what_is_missing_is_named(
    bundle: Bundle, sensor: VirtualSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    from phytac_design.environments.grasp_environment import GraspEnvironment

    with refused("grasped-object-unknown") as found:
        GraspEnvironment(thing="vase", design=design(), bundle=bundle, sensor=sensor)
    assert "cup, egg, ball" in str(found.value)
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "phytac_design.environments")
    with refused("missing-library") as found:
        importlib.import_module("phytac_design.environments")
    assert "phytac-design[environments]" in str(found.value)
