"""What the project says of itself agrees: version, licence, addresses, the two commands that run elsewhere."""

import tomllib
from pathlib import Path

import yaml

import torchhand

REPOSITORY = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def read(name: str) -> dict:
    return yaml.safe_load((REPOSITORY / name).read_text(encoding="utf-8"))


def test_how_to_cite_is_of_this_version() -> None:
    citation = read("CITATION.cff")
    assert citation["version"] == PROJECT["version"] == torchhand.__version__
    assert citation["license"] == PROJECT["license"]
    assert [one["name"] for one in citation["authors"]] == [one["name"] for one in PROJECT["authors"]]


def test_addresses_agree() -> None:
    urls, site, citation = PROJECT["urls"], read(".mkdocs.yml"), read("CITATION.cff")
    assert urls["Source"] == site["repo_url"] == citation["repository-code"]
    assert urls["Documentation"] == site["site_url"] == citation["url"]
    assert {urls["Issues"], urls["Changelog"]} == {
        f"{urls['Source']}/issues",
        f"{urls['Source']}/blob/main/CHANGELOG.md",
    }
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    assert urls["Documentation"] in readme
    assert urls["Source"].removeprefix("https://github.com/") in readme


def test_the_workflow_runs_the_two_commands() -> None:
    steps = [step.get("run") for job in read(".github/workflows/test.yml")["jobs"].values() for step in job["steps"]]
    for command in ("bash scripts/demo.sh", "bash scripts/test.sh"):
        assert command in steps
        assert (REPOSITORY / command.split()[1]).is_file()


def test_what_is_checked_before_a_commit_is_what_the_tests_check() -> None:
    hooks = {hook["id"]: hook for repo in read(".pre-commit-config.yaml")["repos"] for hook in repo["hooks"]}
    script = (REPOSITORY / "scripts" / "test.sh").read_text(encoding="utf-8")
    constraints = (REPOSITORY / "scripts" / "constraints.txt").read_text().splitlines()
    assert list(hooks) == ["ruff-check", "ruff-format"]
    for name, hook in hooks.items():
        assert f"-m {name.replace('-', ' ')}" in script
        assert hook["entry"].startswith(f"{name.replace('-', ' ')} ")
        assert set(hook["additional_dependencies"]) <= set(constraints)


def test_pages_in_the_navigation_exist_and_all_pages_are_in_it() -> None:
    def files(entry: object) -> list[str]:
        if isinstance(entry, str):
            return [entry]
        parts = entry.values() if isinstance(entry, dict) else entry
        return [name for part in parts for name in files(part)]  # type: ignore[union-attr]

    assert sorted(files(read(".mkdocs.yml")["nav"])) == sorted(path.name for path in (REPOSITORY / "docs").glob("*.md"))
