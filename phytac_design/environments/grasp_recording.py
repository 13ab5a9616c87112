"""Grasps of the scripted controller as a LeRobot data set."""

from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from phytac_design.core.lerobot_writer import Feature, LeRobotWriter
from phytac_design.environments.grip_controller import GripController

INTERVAL = ("N", "low_N", "high_N")


def record_grasps(environment: Any, folder: Path, *, episodes: int, seed: int = 0) -> list[str]:
    """Let the scripted controller grasp, and write a LeRobot data set.

    Parameters
    ----------
    environment : gymnasium.Env
        One of ``phytac/…``.
    folder : Path
        Folder to make.
    episodes, seed : int
        How many grasps, and the seed of the first; each has the next one.

    Returns
    -------
    list of str
        Outcome of each episode, see
        :class:`phytac_design.environments.grasp_environment.GraspEnvironment`.

    Raises
    ------
    OutputError
        If the folder exists, or cannot be written.
    """
    own, outcomes = environment.unwrapped, []
    features = grasp_features(own.observation_space)
    with LeRobotWriter(folder, fps=round(1.0 / own.frame_s), features=features) as writer:
        for number in range(episodes):
            controller = GripController(thing=own.thing)
            seen, info = environment.reset(seed=seed + number)
            done = False
            while not done:
                action = controller.act(seen)
                after, reward, terminated, truncated, info = environment.step(action)
                done = terminated or truncated
                success = info["outcome"] == "held"
                writer.add(
                    grasp_frame(seen)
                    | {
                        "action": action,
                        "next.reward": reward,
                        "next.done": done,
                        "next.success": success,
                    }
                )
                seen = after
            writer.end_episode(f"hold the {own.thing.name}")
            outcomes.append(str(info["outcome"]))
    return outcomes


def grasp_features(space: Any) -> dict[str, Feature]:
    """Columns of grasps, for an observation space of the environments."""
    count = space["contacts_N"].shape[0]
    contacts = [f"{part}_{k}" for k in range(count) for part in INTERVAL]
    places = [f"{axis}_mm_{k}" for k in range(count) for axis in ("x", "y", "z")]
    return {
        "observation.state": Feature("float32", 2, ["closed_mm", "lifted_mm"]),
        "observation.grip": Feature("float32", 3, INTERVAL),
        "observation.contacts": Feature("float32", 3 * count, contacts),
        "observation.contact_places": Feature("float32", 3 * count, places),
        "observation.switches": Feature("float32", int(space["switches"].n)),
        "observation.valid": Feature("float32", 1),
        "action": Feature("float32", 2, ["closing", "lifting"]),
        "next.reward": Feature("float32", 1),
        "next.done": Feature("bool", 1),
        "next.success": Feature("bool", 1),
    }


def grasp_frame(observation: dict[str, Any]) -> dict[str, ArrayLike]:
    """Return an observation as a part of a row of :func:`grasp_features`."""
    return {
        "observation.state": observation["hand_mm"],
        "observation.grip": observation["grip_N"],
        "observation.contacts": observation["contacts_N"].ravel(),
        "observation.contact_places": observation["contacts_mm"].ravel(),
        "observation.switches": observation["switches"],
        "observation.valid": observation["valid"],
    }
