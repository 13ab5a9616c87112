"""Gymnasium environments with a simulated sensor in the loop; importing this registers them.

``phytac/Cup-v0``, ``phytac/Egg-v0`` and ``phytac/Ball-v0``: see
:class:`phytac_design.environments.grasp_environment.GraspEnvironment`.
"""

from phytac_shapes.errors import MissingPartError

try:
    from gymnasium import register as _register
except ImportError:
    raise MissingPartError.of_library(
        "phytac_design.environments", "gymnasium", "environments"
    ) from None

EPISODE_FRAMES = 450
"""Frames after which an episode is truncated: 15 s at 30 Hz."""

for _name in ("Cup", "Egg", "Ball"):
    _register(
        f"phytac/{_name}-v0",
        entry_point="phytac_design.environments.grasp_environment:GraspEnvironment",
        max_episode_steps=EPISODE_FRAMES,
        kwargs={"thing": _name.lower()},
    )
