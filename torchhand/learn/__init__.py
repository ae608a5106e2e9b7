"""A learning example: a small network from 21 points in a picture to a pose, trained on samples of the prior."""

from torchhand.learn.data import HandPool, Samples, SampleSettings, draw_samples, hand_pool
from torchhand.learn.estimate import estimate_hands
from torchhand.learn.figures import FIGURES, Figures, baseline_of, figures_of
from torchhand.learn.loop import Loss, descend, warmed_cosine
from torchhand.learn.network import HandEstimate, PoseNetwork
from torchhand.learn.observation import FEATURES, MIN_SEEN, Observation, mirrored, observe
from torchhand.learn.record import (
    CURVE_NAME,
    MODEL_NAME,
    Curve,
    TrainingRecord,
    curve_of,
    curve_text,
    kept_of,
    load_record,
    read_model,
    save_record,
    write_model,
)
from torchhand.learn.stills import Stills, load_stills
from torchhand.learn.training import (
    LossWeights,
    Training,
    TrainingData,
    TrainingSettings,
    kept_state,
    learning_rate,
    loss_terms,
    new_training,
    restored,
    snapshot,
    train,
    training_data,
)

__all__ = [
    "CURVE_NAME",
    "FEATURES",
    "FIGURES",
    "MIN_SEEN",
    "MODEL_NAME",
    "Curve",
    "Figures",
    "HandEstimate",
    "HandPool",
    "Loss",
    "LossWeights",
    "Observation",
    "PoseNetwork",
    "SampleSettings",
    "Samples",
    "Stills",
    "Training",
    "TrainingData",
    "TrainingRecord",
    "TrainingSettings",
    "baseline_of",
    "curve_of",
    "curve_text",
    "descend",
    "draw_samples",
    "estimate_hands",
    "figures_of",
    "hand_pool",
    "kept_of",
    "kept_state",
    "learning_rate",
    "load_record",
    "load_stills",
    "loss_terms",
    "mirrored",
    "new_training",
    "observe",
    "read_model",
    "restored",
    "save_record",
    "snapshot",
    "train",
    "training_data",
    "warmed_cosine",
    "write_model",
]
