"""Known objects in a frame, by what can be recognised of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from aerograsp_env.interfaces import RGBD, Detection
from baselines.detection.feature_model import FEATURES, FeatureModel


class FeatureDetector:
    """A `Detector` of known objects by their feature models.

    The score is I / (I + 12) of I inliers: 0.5 at a dozen. Boxes span the model's points, hidden ones too.
    """

    def __init__(self, models: Sequence[FeatureModel] | Mapping[str, FeatureModel], n: int = FEATURES):
        items = dict(models) if isinstance(models, Mapping) else {model.name: model for model in models}
        if not items:
            raise ValueError("models: expected at least one feature model, got none")
        self._models, self._n = items, n

    def detect(self, frame: RGBD) -> list[Detection]:
        """The objects found in the frame's colour image, best score first."""
        found = []
        for label, model in self._models.items():
            pose = model.locate(frame.rgb, frame.intrinsics, n=self._n)
            box = None if pose.T_c_object is None else model.box(pose.T_c_object, frame.intrinsics)
            if box is not None:
                score = pose.inliers / (pose.inliers + 12.0)
                found.append(Detection(label, score, box, pose.T_c_object, pose.covariance))
        return sorted(found, key=lambda d: -d.score)
