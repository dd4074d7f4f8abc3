"""Learning: models of postures and motions, fitted to recordings.

- `posture_library`: postures with joint names and object sizes, as CSV or Parquet
- `synergies`: principal components of postures, and their reconstruction errors
- `object_size`: correlation of synergies with object size, and the pre-shape for a size
- `glove`: calibration of a glove, its fingertips mapped to another hand, and teleoperation
- `inverse_kinematics`: networks that give start values to the inverse kinematics
- `squeeze`: how hard to squeeze, with calibrated confidence
- `actions`: motions of fingers in a recording, their order, and how common an order is

Synergies need scikit-learn, and Parquet files pyarrow: ``pip install "graspforce[learn]"``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspforce.core.lazy import lazy_exports

if TYPE_CHECKING:
    from graspforce.learning.actions.finger_angles import finger_angles
    from graspforce.learning.actions.gist_ranking import ActionGist, GistHistogram, RankedGist, rank_gists
    from graspforce.learning.actions.labels import (
        MotionLabel,
        MotionMonitor,
        label_motions,
        labelled_gist,
        labels_at,
        load_labels,
        save_labels,
    )
    from graspforce.learning.actions.meta_motions import META_MOTIONS, meta_motion_conditions
    from graspforce.learning.actions.recorded_motion import RecordedMotion, recorded_motion
    from graspforce.learning.actions.retrieval import SimilarRecording, find_similar, gist_similarity
    from graspforce.learning.actions.segmentation import GistSettings, MotionSegment, action_gist, segment_finger
    from graspforce.learning.glove.calibration import GloveCalibration, GloveDrift, calibrate_glove
    from graspforce.learning.glove.fingertip_mapping import FingertipMap, FingertipMapper, MappedPosture, fit_fingertip_map
    from graspforce.learning.glove.frames import LiveFrames, RecordedFrames
    from graspforce.learning.glove.glove_inputs import (
        GloveApproach,
        GloveHold,
        GloveOperator,
        GloveReference,
        neutral_correspondence,
    )
    from graspforce.learning.glove.simulated_glove import SimulatedGlove
    from graspforce.learning.glove.teleoperation import (
        ApproachLimits,
        PostureFilter,
        TeleoperationFilter,
        TeleoperationLimits,
        virtual_object,
    )
    from graspforce.learning.inverse_kinematics import FingerStart, Network, fit_finger_start, fit_network
    from graspforce.learning.object_size import PreshapeModel, SizeCorrelation, correlate_with_size, fit_preshape
    from graspforce.learning.posture_library import PostureLibrary
    from graspforce.learning.squeeze import SqueezeModel, fit_squeeze, robust_squeeze, squeeze_features, with_squeeze
    from graspforce.learning.synergies import Synergies, fit_synergies

__all__ = [
    "META_MOTIONS",
    "ActionGist",
    "ApproachLimits",
    "FingerStart",
    "FingertipMap",
    "FingertipMapper",
    "GistHistogram",
    "GistSettings",
    "GloveApproach",
    "GloveCalibration",
    "GloveDrift",
    "GloveHold",
    "GloveOperator",
    "GloveReference",
    "LiveFrames",
    "MappedPosture",
    "MotionLabel",
    "MotionMonitor",
    "MotionSegment",
    "Network",
    "PostureFilter",
    "PostureLibrary",
    "PreshapeModel",
    "RankedGist",
    "RecordedFrames",
    "RecordedMotion",
    "SimilarRecording",
    "SimulatedGlove",
    "SizeCorrelation",
    "SqueezeModel",
    "Synergies",
    "TeleoperationFilter",
    "TeleoperationLimits",
    "action_gist",
    "calibrate_glove",
    "correlate_with_size",
    "find_similar",
    "finger_angles",
    "fit_finger_start",
    "fit_fingertip_map",
    "fit_network",
    "fit_preshape",
    "fit_squeeze",
    "fit_synergies",
    "gist_similarity",
    "label_motions",
    "labelled_gist",
    "labels_at",
    "load_labels",
    "meta_motion_conditions",
    "neutral_correspondence",
    "rank_gists",
    "recorded_motion",
    "robust_squeeze",
    "save_labels",
    "segment_finger",
    "squeeze_features",
    "virtual_object",
    "with_squeeze",
]

_HOMES = {
    "posture_library": ("PostureLibrary",),
    "squeeze": ("SqueezeModel", "fit_squeeze", "robust_squeeze", "squeeze_features", "with_squeeze"),
    "synergies": ("Synergies", "fit_synergies"),
    "object_size": ("PreshapeModel", "SizeCorrelation", "correlate_with_size", "fit_preshape"),
    "inverse_kinematics": ("FingerStart", "Network", "fit_finger_start", "fit_network"),
    "glove.calibration": ("GloveCalibration", "GloveDrift", "calibrate_glove"),
    "glove.fingertip_mapping": ("FingertipMap", "FingertipMapper", "MappedPosture", "fit_fingertip_map"),
    "glove.frames": ("LiveFrames", "RecordedFrames"),
    "glove.teleoperation": (
        "ApproachLimits",
        "PostureFilter",
        "TeleoperationFilter",
        "TeleoperationLimits",
        "virtual_object",
    ),
    "glove.glove_inputs": ("GloveApproach", "GloveHold", "GloveOperator", "GloveReference", "neutral_correspondence"),
    "glove.simulated_glove": ("SimulatedGlove",),
    "actions.meta_motions": ("META_MOTIONS", "meta_motion_conditions"),
    "actions.segmentation": ("GistSettings", "MotionSegment", "action_gist", "segment_finger"),
    "actions.finger_angles": ("finger_angles",),
    "actions.labels": (
        "MotionLabel",
        "MotionMonitor",
        "label_motions",
        "labelled_gist",
        "labels_at",
        "load_labels",
        "save_labels",
    ),
    "actions.recorded_motion": ("RecordedMotion", "recorded_motion"),
    "actions.retrieval": ("SimilarRecording", "find_similar", "gist_similarity"),
    "actions.gist_ranking": ("ActionGist", "GistHistogram", "RankedGist", "rank_gists"),
}
__getattr__ = lazy_exports(__name__, {name: f"{__name__}.{home}" for home, names in _HOMES.items() for name in names})
