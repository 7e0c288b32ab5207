"""Propwash: a drone simulator that flies, sees and touches in any MuJoCo scene.

``Sim`` flies many worlds of many drones at once; arrays are NumPy arrays of shape ``(n_worlds, n_drones, ...)``. Units are SI,
quaternions are x y z w from body to world, world z points up, body x forward, y left, z up.
"""

from ._mujoco import load_library as _load_library

_load_library()

from ._native import (  # noqa: E402
    Error,
    RestOnGround,
    State,
    Vehicle,
    __version__,
    load_plugin_library,
    mujoco_version,
    scenes,
    vehicles,
)
from ._repr import shorten_all as _shorten_all  # noqa: E402
from ._rerun import write_rerun  # noqa: E402
from ._video import video  # noqa: E402
from .command import Command  # noqa: E402
from .controllers import Controller, controller  # noqa: E402
from .costs import Cost, Priced, cost  # noqa: E402
from .field import DistanceField  # noqa: E402
from .gap import (  # noqa: E402
    AcceptedParameter,
    Change,
    ChangedParameter,
    Comparison,
    Diagnosis,
    Finding,
    LogComparison,
    Moment,
    Parameter,
    Report,
    Rung,
    Section,
    Watched,
    WatchedLog,
    add,
    compare,
    diagnose,
    watch,
)
from .jobs import (  # noqa: E402
    Advice,
    Estimate,
    FirstNumber,
    FirstVehicle,
    FlightPlan,
    Flown,
    GeomLint,
    Identification,
    LintReport,
    LogChannel,
    LogFinding,
    LogReport,
    Manoeuvre,
    ManoeuvreFlight,
    Motors,
    excite,
    fly,
    identify,
    lint,
    log_check,
    manoeuvres,
    scene_new,
    tell_apart,
    vehicle_new,
    vehicle_throttle,
)
from .lab import Lab, LabEffect, LabFigures, LabParameter, LabResidual, LabSaved  # noqa: E402
from .effects import Effect, EffectParameter, effect  # noqa: E402
from .policies import Evaluation, EvaluationRow, Policy, evaluate  # noqa: E402
from .recorder import Recorder  # noqa: E402
from .references import MinimumSnap  # noqa: E402
from .scene import Body, Geom, Obstacle, SceneCamera, SceneInfo  # noqa: E402
from .sense import Camera, Clearance, Contacts, DepthFrame, DepthGradient, DepthSlopes, PixelStatus, PoseGradient, Swept  # noqa: E402
from .sim import CommandWarning, Data, Pipeline, Quarantine, QuarantineWarning, SceneWarning, SensorChannel, Sim  # noqa: E402
from .sitl import Sitl, SitlTouch, SitlTraffic  # noqa: E402
from .tape import Approach, Gradient, States, Tape  # noqa: E402
from .view import View  # noqa: E402
from .viewer import Viewer  # noqa: E402

__all__ = [
    "AcceptedParameter",
    "Advice",
    "Approach",
    "Body",
    "Camera",
    "Change",
    "ChangedParameter",
    "Clearance",
    "Command",
    "CommandWarning",
    "Comparison",
    "Contacts",
    "Controller",
    "Cost",
    "Data",
    "DepthFrame",
    "DepthGradient",
    "DepthSlopes",
    "Diagnosis",
    "DistanceField",
    "Effect",
    "EffectParameter",
    "Error",
    "Estimate",
    "Evaluation",
    "EvaluationRow",
    "Finding",
    "FirstNumber",
    "FirstVehicle",
    "FlightPlan",
    "Flown",
    "Geom",
    "GeomLint",
    "Gradient",
    "Identification",
    "Lab",
    "LabEffect",
    "LabFigures",
    "LabParameter",
    "LabResidual",
    "LabSaved",
    "LintReport",
    "LogChannel",
    "LogComparison",
    "LogFinding",
    "LogReport",
    "Manoeuvre",
    "ManoeuvreFlight",
    "MinimumSnap",
    "Moment",
    "Motors",
    "Obstacle",
    "Parameter",
    "Pipeline",
    "PixelStatus",
    "Policy",
    "PoseGradient",
    "Priced",
    "Quarantine",
    "QuarantineWarning",
    "Recorder",
    "Report",
    "RestOnGround",
    "Rung",
    "SceneCamera",
    "SceneInfo",
    "SceneWarning",
    "Section",
    "SensorChannel",
    "Sim",
    "Sitl",
    "SitlTouch",
    "SitlTraffic",
    "State",
    "States",
    "Swept",
    "Tape",
    "Vehicle",
    "View",
    "Viewer",
    "Watched",
    "WatchedLog",
    "__version__",
    "add",
    "compare",
    "controller",
    "cost",
    "diagnose",
    "effect",
    "evaluate",
    "excite",
    "fly",
    "identify",
    "lint",
    "load_plugin_library",
    "log_check",
    "manoeuvres",
    "mujoco_version",
    "scene_new",
    "scenes",
    "tell_apart",
    "vehicle_new",
    "vehicle_throttle",
    "vehicles",
    "video",
    "watch",
    "write_rerun",
]

_shorten_all(globals())
