#!/usr/bin/env -S uv run --script
# /// script
# dependencies = ["nox>=2025.2"]
# ///
"""Tasks: `nox` runs what a change must pass, `nox --list` shows all, `nox -s tests-3.12` runs one."""

from pathlib import Path

import nox

nox.needs_version = ">=2025.2"
nox.options.default_venv_backend = "uv|virtualenv"
nox.options.error_on_missing_interpreters = False

PYTHONS = ["3.11", "3.12", "3.13", "3.14"]
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
IN_PARALLEL = ("--numprocesses", "auto", "--dist", "worksteal")


@nox.session
def lint(session: nox.Session) -> None:
    """Lint, format and types."""
    session.install("--editable", ".[dev,docs,mesh,test]")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("mypy")


@nox.session
def docs(session: nox.Session) -> None:
    """The site of the documentation, built strictly into site/."""
    session.install("--editable", ".[docs,test]")
    session.run("mkdocs", "build", "--quiet", "--strict", env={"NO_MKDOCS_2_WARNING": "1"})


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Fast tests, or what is asked for: nox -s tests-3.12 -- -m slow."""
    session.install("--editable", ".[test]")
    session.run("python", "-m", "pytest", *IN_PARALLEL, *session.posargs, env=ONE_THREAD)


@nox.session(python="3.11", venv_backend="uv", default=False)
def lowest(session: nox.Session) -> None:
    """Fast tests with the lowest versions that pyproject.toml accepts."""
    session.install("--resolution", "lowest-direct", "--only-binary", ":all:", "--editable", ".[test]")
    session.run("python", "-m", "pytest", *IN_PARALLEL, *session.posargs, env=ONE_THREAD)


@nox.session(default=False)
def wheel(session: nox.Session) -> None:
    """The wheel and the source distribution in dist/, each installed and asked for a plate's constants."""
    session.install("build")
    session.run("python", "-m", "build", "--outdir", "dist", ".")
    for built in sorted([*Path("dist").glob("*.whl"), *Path("dist").glob("*.tar.gz")]):
        session.install(str(built.absolute()))
        session.install("--force-reinstall", "--no-deps", str(built.absolute()))  # both have one version
        with session.chdir(session.create_tmp()):
            session.run("cpam-bayes", "identify", "A1", "--swarms", "1", "--json", "--quiet", silent=True)


if __name__ == "__main__":
    nox.main()
