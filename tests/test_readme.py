"""What the README shows must run and be there."""

import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")


def test_the_example_runs_and_its_gradients_are_those_of_the_pinch(capsys) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names: dict = {}
    exec(compile(example, "README.md", "exec"), names)
    gradient = names["pose"].grad
    assert gradient.isfinite().all()
    # The distance between two fingertips does not depend on where the hand is, but does on the thumb's joints.
    assert float(gradient[:3].abs().max()) < 1e-12
    assert float(gradient[6:9].abs().max()) > 1e-3
    assert float(names["shape"].grad.abs().max()) > 1e-3
    assert "thumb_cmc_fe" in capsys.readouterr().out


def test_pictures_and_pages_that_it_names_exist() -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", README)
    assert targets
    assert [target for target in targets if not (REPOSITORY / target).exists()] == []
