"""Of several registrations the one that explains the picture best is as good as any one, or better."""

import numpy as np
import torch

from torchhand.files import load_hand_model
from torchhand.fit import PostureResiduals
from torchhand.study import PerturbationSettings
from torchhand.study.hypotheses.case_study import CaseStudy, StudyBatch
from torchhand.study.hypotheses.proportions import success_of_best
from torchhand.study.hypotheses.settings import HypothesisStudySettings
from torchhand.study.hypotheses.simulated import simulated_case

PICTURES, STARTS = (10, 19), 32


def test_more_starts_of_small_perturbations_are_never_worse() -> None:
    """By the cost with its priors they are: a wrong hand of a broad kind of postures is cheap."""
    settings = HypothesisStudySettings(
        perturbation=PerturbationSettings(angle_deg=3.0, translation_mm=2.0, rotation_deg=3.0, levels=1),
        has_start_prior=False,
    )
    model = load_hand_model()
    prior, postures = model.prior(dtype=torch.float64), PostureResiduals.of(model.prior().postures)
    success = {tries: [] for tries in (1, 2, 4, 8, 16)}
    for number in PICTURES:
        case = simulated_case(number, prior, settings, seed=0)
        found = CaseStudy(case, model, settings, postures).run(StudyBatch(index=0, case=0, first=0, count=STARTS), 0)
        for tries, own in success.items():
            own.append(success_of_best(found.misfit, found.is_success(settings.success_deg), tries))
    one, *several = (float(np.mean(own)) for own in success.values())
    assert one > 0.5
    assert min(several) >= one - 1e-12, success
