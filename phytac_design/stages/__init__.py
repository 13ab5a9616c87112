"""The stages of a build, in order."""

from phytac_design.engine.stage import Stage
from phytac_design.stages.calibration_rig import KIT
from phytac_design.stages.decoder import DECODER
from phytac_design.stages.documents import BENCH
from phytac_design.stages.frames import FRAMES
from phytac_design.stages.hardware import HARDWARE
from phytac_design.stages.loaded_views import UNDERLOAD
from phytac_design.stages.mesh import MESH
from phytac_design.stages.mold import MOLD
from phytac_design.stages.places import PLACES
from phytac_design.stages.printing import PRINTING
from phytac_design.stages.report import REPORT
from phytac_design.stages.resolution import RESOLUTION
from phytac_design.stages.response import RESPONSE, TWIN
from phytac_design.stages.shell import SHELL, STEP
from phytac_design.stages.switch import SWITCH
from phytac_design.stages.views import COMPARE, VIEWS

STAGES: tuple[Stage, ...] = (
    VIEWS,
    SWITCH,
    COMPARE,
    UNDERLOAD,
    RESOLUTION,
    SHELL,
    STEP,
    HARDWARE,
    MOLD,
    KIT,
    PRINTING,
    BENCH,
    MESH,
    RESPONSE,
    PLACES,
    TWIN,
    DECODER,
    FRAMES,
    REPORT,
)

__all__ = ["STAGES"]
