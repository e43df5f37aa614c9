"""The hosted workflow does what .ci/run does, on Pythons that the project is for."""

import re
import tomllib

import yaml

from tests.helpers.repository import REPOSITORY

WORKFLOW = yaml.safe_load((REPOSITORY / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8"))


def test_it_runs_the_same_targets() -> None:
    local = re.findall(r"^make (\w+)", (REPOSITORY / ".ci" / "run").read_text(encoding="utf-8"), re.MULTILINE)
    hosted = [step["run"].split()[1] for step in WORKFLOW["jobs"]["test"]["steps"] if "run" in step]
    assert hosted == local == ["test", "demo"]


def test_its_pythons_are_the_projects() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pythons = WORKFLOW["jobs"]["test"]["strategy"]["matrix"]["python"]
    assert f">={pythons[0]}" == project["requires-python"]
    classified = [each.rpartition(" ")[2] for each in project["classifiers"] if "Python :: 3." in each]
    assert set(classified) <= set(pythons)


def test_its_actions_are_pinned_by_digest() -> None:
    steps = [step for job in WORKFLOW["jobs"].values() for step in job["steps"]]
    used = [step["uses"] for step in steps if "uses" in step]
    assert used and [name for name in used if not re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", name)] == []


def test_the_image_does_not_run_as_root() -> None:
    lines = (REPOSITORY / "Dockerfile").read_text(encoding="utf-8").splitlines()
    users = [line.split()[1] for line in lines if line.startswith("USER ")]
    assert users and users[-1] not in ("root", "0")
    assert lines.index(f"USER {users[-1]}") < next(n for n, line in enumerate(lines) if line.startswith("ENTRYPOINT"))


def test_the_image_copies_all_that_the_wheel_is_built_of() -> None:
    kept = (REPOSITORY / ".dockerignore").read_text(encoding="utf-8").splitlines()
    build = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    packages = build["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    wanted = {*packages, "pyproject.toml", build["project"]["readme"], "constraints.txt"}
    assert wanted <= {line.removeprefix("!") for line in kept}
