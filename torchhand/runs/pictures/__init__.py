"""Single pictures: the hands of a folder of them, each by itself, into a result folder."""

from torchhand.runs.pictures.inputs import pictures_in
from torchhand.runs.pictures.run import PicturesRequest, fit_pictures, single_pose_fitter
from torchhand.runs.pictures.short import fit_pose

__all__ = ["PicturesRequest", "fit_pictures", "fit_pose", "pictures_in", "single_pose_fitter"]
