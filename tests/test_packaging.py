"""Test the package's metadata: extras resolve to the pins, versions match, and the wheel has every file."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, requires
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import pytest

import robustflow

packaging = pytest.importorskip("packaging", reason="needs the extra dev")
yaml = pytest.importorskip("yaml", reason="needs the extra dev")

from packaging.requirements import Requirement  # noqa: E402
from packaging.utils import canonicalize_name  # noqa: E402
from packaging.version import Version  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
OPTIONAL = PROJECT["optional-dependencies"]


def pins():
    """Versions in constraints.txt by canonical name."""
    lines = [line.partition("#")[0].strip() for line in (ROOT / "constraints.txt").read_text().splitlines()]
    return {canonicalize_name(name): version for name, _, version in (line.partition("==") for line in lines if line)}


def test_constraints_contain_only_names_and_versions():
    for line in (ROOT / "constraints.txt").read_text().splitlines():
        assert re.fullmatch(r"#.*|[\w.-]+==[\w.+-]+", line), line


@pytest.mark.parametrize("extra", ["", *OPTIONAL])
def test_an_extra_resolves_to_its_pins(extra):
    known = pins()
    requirements = [Requirement(text) for text in (OPTIONAL[extra] if extra else PROJECT["dependencies"])]
    for requirement in requirements:
        name = canonicalize_name(requirement.name)
        if name == "robustflow":
            assert requirement.extras <= set(OPTIONAL)
        else:
            assert name in known, f"{requirement} of [{extra}] has no line in constraints.txt"
            assert known[name] in requirement.specifier, (
                f"{requirement} of [{extra}] does not allow {name}=={known[name]}"
            )


@pytest.mark.slow
@pytest.mark.parametrize("extra", sorted({*OPTIONAL} - {"bench"}))
def test_an_installer_finds_no_conflict_between_the_pins_and_no_package_without_one(extra, tmp_path):
    """Resolve an extra and all its dependencies. One extra states that it needs a separate environment."""
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--quiet"]
    command += ["--report", "-", "-c", str(ROOT / "constraints.txt"), f"{ROOT}[{extra}]"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=600)
    if "connection" in done.stderr.lower() and "conflict" not in done.stderr.lower():
        pytest.skip("no package index can be reached")
    assert done.returncode == 0, done.stderr[-2000:]
    installed = {canonicalize_name(one["metadata"]["name"]) for one in json.loads(done.stdout)["install"]}
    assert installed - pins().keys() == {"robustflow"}


with (ROOT / "tests" / "advisories.csv").open() as _file:
    ADVISORIES = {row["package"]: row for row in csv.DictReader(_file)}
"""Packages with the version that fixes all their advisories, compiled in November 2026."""


@pytest.mark.parametrize("package", ADVISORIES)
def test_no_version_with_a_known_vulnerability_is_pinned_or_allowed(package):
    fixed = Version(ADVISORIES[package]["fixed"])
    assert Version(pins()[package]) >= fixed
    for requirement in map(Requirement, [*PROJECT["dependencies"], *chain(*OPTIONAL.values())]):
        if canonicalize_name(requirement.name) == package:
            least = [one.version for one in requirement.specifier if one.operator in (">=", "==")]
            assert least, requirement
            assert max(map(Version, least)) >= fixed, (requirement, ADVISORIES[package]["identifiers"])


def test_every_package_of_an_environment_is_pinned():
    """Follow the requirements of this environment's packages from the project's extras."""
    waiting = [f"robustflow[{extra}]" for extra in OPTIONAL] + ["robustflow"]
    followed: set[str] = set()
    while waiting:
        requirement = Requirement(waiting.pop())
        name = canonicalize_name(requirement.name)
        if str(requirement) in followed:
            continue
        followed.add(str(requirement))
        assert name in ("robustflow", *pins()), requirement
        with suppress(PackageNotFoundError):
            for line in requires(name) or ():
                marker = Requirement(line).marker
                if marker is None or any(marker.evaluate({"extra": extra}) for extra in {"", *requirement.extras}):
                    waiting.append(line.partition(";")[0])
    assert len(followed) > 100


def test_versions_agree_in_all_files():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert newest is not None
    assert citation["version"] == newest[1] == robustflow.__version__


def test_the_paper_is_cited_as_it_is_printed(shared):
    paper = (shared("paper") / "paper.tex").read_text()
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())["preferred-citation"]
    assert "\\title{" + cited["title"] + "}" in paper
    (authors,) = re.findall(r"\\author\{(.*?)\\\\\\normalsize", paper.replace("\n", ""))
    printed = re.findall(r"([A-Z][a-z]+ [A-Z][a-z]+)(?=\$|,|\\thanks)", re.sub(r"\\thanks\{.*?\}\.?\}?", "", authors))
    assert [f"{one['given-names']} {one['family-names']}" for one in cited["authors"]] == printed
    assert cited["repository-code"] in paper


def test_the_workflow_runs_what_every_machine_runs():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    (job,) = workflow["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == [".ci/run"]
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_dockerfile_copies_existing_files_that_dockerignore_admits():
    dockerfile = (ROOT / "Dockerfile").read_text()
    passed = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = {
        source for line in re.findall(r"^COPY (?!--from)(.+) \S+$", dockerfile, re.MULTILINE) for source in line.split()
    }
    assert copied == passed != set()
    assert all((ROOT / name).exists() for name in copied)
    (extras,) = re.findall(r"^ARG EXTRAS=(\S+)$", dockerfile, re.MULTILINE)
    assert set(extras.split(",")) <= set(OPTIONAL)


@pytest.mark.skipif(shutil.which("hadolint") is None, reason="needs hadolint (extra dev)")
def test_the_dockerfile_is_linted():
    linted = subprocess.run(["hadolint", str(ROOT / "Dockerfile")], capture_output=True, text=True)
    assert linted.returncode == 0, linted.stdout


@pytest.mark.slow
@pytest.mark.skipif(find_spec("build") is None, reason="needs the library build (extra dev)")
def test_wheel_and_source_distribution_are_complete_and_run(tmp_path):
    subprocess.run([sys.executable, "-m", "build", "--outdir", str(tmp_path), str(ROOT)], check=True, timeout=600)
    (wheel,), (source,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    package = {
        path.relative_to(ROOT / "src").as_posix()
        for path in (ROOT / "src" / "robustflow").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert packed == package
    assert "robustflow/py.typed" in packed
    assert wheel.stat().st_size < 7 << 20  # the three networks take 4.6 MB
    with tarfile.open(source) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"constraints.txt", "LICENSE", "README.md", "docs/add-your-model.md", "tests/test_guides.py"} <= names

    installed = tmp_path / "installed"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(installed), str(wheel)]
    subprocess.run(pip, check=True, timeout=300)
    command = [sys.executable, "-m", "robustflow", "run", "--model", "dis", "-c", "fog", "-s", "3", "--output", "run"]
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=300)
    assert (tmp_path / "run" / "report.html").is_file()
    where = [sys.executable, "-c", "import robustflow; print(robustflow.__file__)"]
    imported = subprocess.run(where, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True).stdout
    assert Path(imported.strip()).is_relative_to(installed)
