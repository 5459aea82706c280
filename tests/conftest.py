"""One BLAS thread for all tests, and the option that makes a skipped test a failed one."""

import os
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests import shared
from tests.plate_file import MEASURED, PLATE

# Before a test module loads numpy: two threads slow down stacked eigenproblems.
os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True)
class FailuresAtOnce:
    """Reports a failure when it happens, so that it is seen even if the run is cut off."""

    config: pytest.Config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            terminal = self.config.pluginmanager.get_plugin("terminalreporter")
            last = report.longreprtext.splitlines()[-20:]
            terminal.write_line("\n".join(("", f"FAILED {report.nodeid} ({report.when})", *last)))


def pytest_configure(config: pytest.Config) -> None:
    """Give each process of pytest-xdist a core of its own, so that commands under test start no workers."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        config.pluginmanager.register(FailuresAtOnce(config))
    number = os.environ.get("PYTEST_XDIST_WORKER", "").removeprefix("gw")
    if number and hasattr(os, "sched_setaffinity"):
        allowed = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {allowed[int(number) % len(allowed)]})


@pytest.fixture(scope="session", autouse=True)
def _run_directory(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Put default stores of commands into the directory of the run, which its processes share."""
    process = tmp_path_factory.getbasetemp()
    run = process.parent if "PYTEST_XDIST_WORKER" in os.environ else process
    os.environ |= {"CPAM_BAYES_CACHE": str(run / "cache"), shared.DIRECTORY: str(run / "shared")}
    (run / "shared").mkdir(exist_ok=True)


@pytest.fixture(scope="session", autouse=True)
def _models_of_the_run(_run_directory: None) -> None:
    """Make each plate model once per run, in whichever process needs it first."""
    from cpam_bayes.forward_model import build

    build._made = shared.ModelsOfTheRun(Path(os.environ[shared.DIRECTORY]))


@pytest.fixture(scope="session", autouse=True)
def _documents_follow_their_schemas() -> None:
    """Validate each document that the package makes in any test against its schema."""
    from cpam_bayes import result
    from cpam_bayes.questions import report

    made = result.document_of

    def held_against_its_schema(answer: Any, shown: Any) -> dict[str, Any]:
        from cpam_bayes.documents import validated

        document = made(answer, shown)
        if type(answer).__module__.startswith("cpam_bayes."):  # tests make answers of other kinds
            try:
                validated(answer.command, document)
            except ValueError as error:
                raise AssertionError(f"{answer.command}: {error}") from None
        return document

    result.document_of = report.document_of = held_against_its_schema


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[object, str, str]]:
    """Run a command in this process; returns exit status, standard output, standard error."""
    from cpam_bayes.cli import main

    def run_here(*argv: object) -> tuple[object, str, str]:
        try:
            status: object = main([str(word) for word in argv])
        except SystemExit as leaving:
            status = leaving.code
        return status, *capsys.readouterr()

    return run_here


@pytest.fixture
def plate_file(tmp_path: Path) -> Callable[..., str]:
    """Write a plate file with replacements, by default the aluminium plate with its list; give its path."""

    def write(*changes: tuple[str, str], text: str = PLATE + MEASURED) -> str:
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "plate.toml"
        path.write_text(text, encoding="utf-8")
        return str(path)

    return write


@pytest.fixture
def few_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a diagnosis weigh only causes that need no further plate model."""
    from cpam_bayes.diagnosis import cases
    from cpam_bayes.questions import diagnose
    from tests.diagnosed import CHEAP

    def some(*args: Any) -> Any:
        return [(h, at) for h, at in cases.hypotheses_of(*args) if h.cause in CHEAP]

    monkeypatch.setattr(diagnose, "hypotheses_of", some)


def pytest_addoption(parser: pytest.Parser) -> None:
    said = "a skipped test fails: for a machine that has all that the tests need"
    parser.addoption("--no-skips", action="store_true", help=said)


def _unless_allowed(report: Any, config: pytest.Config) -> Any:
    """Report of a test or file, failed if it was skipped although --no-skips was given."""
    if report.skipped and not hasattr(report, "wasxfail") and config.option.no_skips:
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        report.outcome = "failed"
        report.longrepr = f"skipped, and --no-skips was given: {reason}"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, Any]:
    return _unless_allowed((yield), item.config)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Generator[None, Any, Any]:
    return _unless_allowed((yield), collector.config)
