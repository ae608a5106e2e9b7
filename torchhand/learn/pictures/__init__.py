"""A network from pictures to hands, trained on the simulator and taught by silhouettes and points of recordings."""

from torchhand.learn.pictures.cutting import cut, moved_intrinsics, window_about
from torchhand.learn.pictures.measuring import (
    RECORDED_FIGURES,
    TrueCrops,
    recorded_figures,
    still_crops,
    true_figures,
)
from torchhand.learn.pictures.record import LOG_NAME, load_picture_record, save_picture_record
from torchhand.learn.pictures.recorded import RecordedCrops, recorded_crops
from torchhand.learn.pictures.simulated import SimulatedCrops
from torchhand.learn.pictures.teaching import Teacher
from torchhand.learn.pictures.training import (
    PictureData,
    PictureProgress,
    PictureTraining,
    new_picture_training,
    picture_data,
    simulated_data,
    step_generator,
    train_from_pictures,
)

__all__ = [
    "LOG_NAME",
    "RECORDED_FIGURES",
    "PictureData",
    "PictureProgress",
    "PictureTraining",
    "RecordedCrops",
    "SimulatedCrops",
    "Teacher",
    "TrueCrops",
    "cut",
    "load_picture_record",
    "moved_intrinsics",
    "new_picture_training",
    "picture_data",
    "recorded_crops",
    "recorded_figures",
    "save_picture_record",
    "simulated_data",
    "step_generator",
    "still_crops",
    "train_from_pictures",
    "true_figures",
    "window_about",
]
