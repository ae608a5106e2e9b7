"""A hypothesis study at work: batch by batch into its folder, and the results of all of them."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import torch
from torch import Tensor

import torchhand
from torchhand.cluster import Cluster
from torchhand.files import CONFIG_ARRAY, camera_entry, load_hand_model, settings_text
from torchhand.files.disk import write_text
from torchhand.fit import PostureResiduals
from torchhand.hand import DOFS, named_pose_space
from torchhand.study.hypotheses.case_study import CaseStudy, StudyBatch, StudyCase, plan_batches
from torchhand.study.hypotheses.folder import CSV_NAME, NPZ_NAME, PICTURE_NAME, StudyFolder, save_study
from torchhand.study.hypotheses.plot import draw_study
from torchhand.study.hypotheses.record import Hypotheses
from torchhand.study.hypotheses.running import run_batches
from torchhand.study.hypotheses.settings import HypothesisStudySettings
from torchhand.study.hypotheses.table import StudyRow, csv_text, study_rows

UNITS = "metres, radians; *_deg degrees, *_mm mm, *_px px"
CONVENTION = (
    "one row per start; pose in the world of the camera file, its rotation vector that of world_from_hand;"
    " perturbation of the free parameters, its rotation applied to the left of the reference's; errors against"
    " reference_pose of the same frame: angle_deg mean of the pose space's joint angles, keypoint_mm mean of the 21"
    " keypoints, rotation_deg of the orientation; misfit the part of the"
    " picture in the cost; NaN, infinite cost and misfit where the status is failed or no_data"
)


@dataclass(frozen=True, kw_only=True)
class Work:
    """One study, ready to be worked on."""

    settings: HypothesisStudySettings
    cases: Sequence[StudyCase]
    """Cases with their final references."""
    overlaps: Sequence[float]
    """Overlaps of the reference hands and the silhouettes."""
    prior: PostureResiduals | None
    seed: int
    source: str
    """Source of the pictures, for the user."""
    reference: str
    """How the reference poses are known, for the user."""
    device: str

    def study(self, case: int) -> CaseStudy:
        """What registrations on one picture share: tens of MB."""
        return CaseStudy(self.cases[case], load_hand_model(), self.settings, self.prior, self.device)

    def header(self) -> dict[str, Any]:
        """What must be equal in a study that is to be resumed."""
        return {
            "torchhand": torchhand.__version__,
            "torch": str(torch.__version__),
            "input": self.source,
            "frames": [case.frame for case in self.cases],
            "settings": asdict(self.settings),
            "seed": self.seed,
            "device": self.device,
            "pictures": self._digest(),
        }

    def _digest(self) -> str:
        """Digest of everything that a registration sees, and of the references."""
        digest = hashlib.sha256()
        for case in self.cases:
            camera, seen = case.camera, (case.image, case.mask, case.pose.dofs, case.pose.reference, case.shape)
            for tensor in (*seen, camera.intrinsics, camera.rotation, camera.translation, camera.distortion):
                digest.update(tensor.cpu().contiguous().numpy().tobytes())
            digest.update(f"{case.side} {camera.kind}".encode())
        return digest.hexdigest()

    def run(self, folder: StudyFolder, workers: int | Cluster) -> tuple[Hypotheses, float]:
        """All hypotheses in order, also those that the folder has; and seconds per start, 0 if none was left.

        workers: how many on this machine, or a cluster.
        """
        plan = plan_batches(self.settings, len(self.cases))
        return run_batches(plan, self.worker, folder, workers, self.device)

    def worker(self, pictures: int = 1) -> Callable[[StudyBatch], Hypotheses]:
        """What registers batches. It keeps what those of one picture share, for so many pictures."""
        study = lru_cache(maxsize=pictures)(self.study)
        return lambda batch: study(batch.case).run(batch, self.seed)

    def save(self, folder: StudyFolder, hypotheses: Hypotheses) -> list[StudyRow]:
        """Write the results and move them into place; returns the rows of the table."""
        rows, references = study_rows(hypotheses, self.settings), self.cases
        further = {
            "dof_names": DOFS,
            "free_names": named_pose_space(self.settings.space).free_names,
            "reference_frame": [case.frame for case in references],
            "reference_pose": torch.stack([case.pose.vector.cpu() for case in references]),
            "reference_shape": torch.stack([case.shape.cpu() for case in references]),
            "reference_overlap": self.overlaps,
            "shape_names": load_hand_model().shape_space.names,
            "success": hypotheses.is_success(self.settings.success_deg),
            "units": UNITS,
            "convention": CONVENTION,
            CONFIG_ARRAY: self._config(),
        }
        with folder.finishing() as place:
            write_text(place / CSV_NAME, csv_text(rows, self.settings))
            write_picture(place / PICTURE_NAME, draw_study(rows, self.settings))
            save_study(place / NPZ_NAME, folder.header, hypotheses, further)
        return rows

    def _config(self) -> str:
        """Every setting, resolved, and what else the study was made of; as YAML that --config reads."""
        first = self.cases[0]
        run = {
            "input": self.source,
            "frames": [case.frame for case in self.cases],
            "reference": self.reference,
            "reference_overlap": self.overlaps,
            "side": first.side,
            "shape_of_first_frame": dict(zip(load_hand_model().shape_space.names, first.shape.tolist(), strict=True)),
            "camera_used": camera_entry(first.camera),
            "camera_is_assumed": first.camera.is_assumed,
            "seed": self.seed,
            "device": self.device,
            "torch": str(torch.__version__),
        }
        return settings_text(self.settings, run)


def write_picture(path: Path, picture: Tensor) -> None:
    _, encoded = cv2.imencode(".png", cv2.cvtColor(picture.numpy(), cv2.COLOR_RGB2BGR))
    path.write_bytes(encoded.tobytes())  # so that the system says why it refuses
