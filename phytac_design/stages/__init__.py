"""The stages of a build, in order."""

from phytac_design.engine.stage import Stage
from phytac_design.stages.calibration_rig_stage import KIT
from phytac_design.stages.decoder_stage import DECODER
from phytac_design.stages.documents_stage import BENCH
from phytac_design.stages.frames_stage import FRAMES
from phytac_design.stages.hardware_stage import HARDWARE
from phytac_design.stages.inserts_stage import INSERTS
from phytac_design.stages.loaded_views_stage import UNDERLOAD
from phytac_design.stages.mesh_stage import MESH
from phytac_design.stages.mold_stage import MOLD
from phytac_design.stages.places_stage import PLACES
from phytac_design.stages.pressed_stage import PRESSED
from phytac_design.stages.printing_stage import PRINTING
from phytac_design.stages.renders_stage import RENDERS
from phytac_design.stages.report_stage import REPORT
from phytac_design.stages.resolution_stage import RESOLUTION
from phytac_design.stages.response_stage import RESPONSE, TWIN
from phytac_design.stages.shell_stage import SHELL, STEP
from phytac_design.stages.switch_stage import SWITCH
from phytac_design.stages.views_stage import COMPARE, VIEWS

STAGES: tuple[Stage, ...] = (
    VIEWS,
    SWITCH,
    COMPARE,
    UNDERLOAD,
    PRESSED,
    RESOLUTION,
    SHELL,
    STEP,
    HARDWARE,
    MOLD,
    KIT,
    INSERTS,
    PRINTING,
    BENCH,
    MESH,
    RESPONSE,
    PLACES,
    TWIN,
    DECODER,
    RENDERS,
    FRAMES,
    REPORT,
)

__all__ = ["STAGES"]
