"""Summaries as people see them: at 80 columns in the terminal, and as a page."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from robustopt.cli import terminal
from robustopt.evidence import Failure, grouped
from robustopt.report import Row, certificate_rows, print_rows, sections, write_page
from robustopt.runs.listing import Listed
from robustopt.runs.records import CertificateRecord, Summary

MARGINS = {"on_grid": -4e-15, "between": -7e-4}
CERTIFICATE = {
    "passed": True, "margin": -7e-4, "level": "quick", "seed": 0, "instants": 9, "intervals": 2,
    "seconds": 1.0, "samples": 100, "tests": 738509,
    "margins": {"joint5 acceleration": MARGINS},
    "worst": {
        "limit": "joint5 acceleration", "margin": -7e-4, "s": 0.1714, "t": 0.427, "on_grid": False,
        "parameters": {}, "place": "between tool_poses[0] and tool_poses[1], at 94 %",
    },
}  # fmt: skip


def printed(rows: list[Row]) -> list[str]:
    stream = StringIO()
    print_rows("Heading", rows, Console(file=stream, width=80))
    return [line.rstrip() for line in stream.getvalue().splitlines()[2:]]


def summary(**values: object) -> Summary:
    return Summary.model_validate({"name": "task", "kind": "plan", "status": "solved", "message": "Done."} | values)


def test_bars_do_not_take_the_room_of_long_values() -> None:
    long = "0.141, 0.291, 0.320, 0.053, 0.482, 0.106"
    lines = printed([Row("success", "4", 1.0), Row("failure", "12", 0.5), Row("acceleration error deviation", long)])
    assert [line.split()[0] for line in lines] == ["success", "failure", "acceleration"]
    assert lines[0].endswith(" 4  " + 24 * "█")
    assert lines[1].endswith("12  " + 12 * "█")
    assert lines[2].endswith(long)


def test_rows_of_a_certificate_fit_on_a_line_each() -> None:
    rows = certificate_rows(CertificateRecord.model_validate(CERTIFICATE))
    lines = printed(rows)
    assert len(lines) == len(rows)
    assert rows[1].value == "0 % of the limit: joint5 acceleration"
    assert rows[2].value == "within tolerance (0.07 % over): joint5 acceleration"
    assert rows[4].value.endswith(", between grid points")


@pytest.mark.parametrize(("count", "last"), [(9, "limit 8"), (10, "2 more")])
def test_limits_are_summed_up_only_if_they_are_several(count: int, last: str) -> None:
    shares = {f"limit {k}": 1 / count for k in range(count)}
    ((_, rows),) = sections(summary(binding=shares))
    assert [row.name for row in rows][-1] == last
    assert sum(row.share or 0.0 for row in rows) == pytest.approx(1.0)


def test_failures_are_summed_up_at_their_median_place_and_time() -> None:
    tips = [Failure("tipped", "upper", "lower", t, s) for t, s in ((0.5, 0.3), (0.52, 0.31), (0.9, 0.6))]
    groups = grouped([Failure("torque saturated", "joint1"), *tips, Failure()])
    executions = {
        "trials": 10, "requested": 10, "successes": 5, "confidence": 0.95, "alike": False, "first_failure": None,
        "seed": 0, "speed": 1.0, "duration": 1.0, "feedback": None, "statuses": {"success": 5, "tipped": 5},
        "failures": [vars(group) for group in groups],
    }  # fmt: skip
    shown = dict(sections(summary(kind="execution", executions=executions)))
    assert printed(shown["Failures, at their median place and time"]) == [
        "  tipped: upper over lower  3 of 10, s = 0.31, t = 0.52 s",
        "  failure                   1 of 10",
        "  torque saturated: joint1  1 of 10",
    ]


def test_runs_show_the_unit_and_the_minute(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = Listed(
        folder="runs/a", created="2026-11-30T11:48:11", kind="plan", state="complete", status="solved", duration=1.25
    )
    terminal.show_runs([run], tmp_path)
    out = capsys.readouterr().out
    assert "duration [s]" in out
    assert out.strip().splitlines()[-1].split()[-3:] == ["2026-11-30", "11:48", "runs/a"]
    assert max(map(len, out.splitlines())) <= 80


def test_page_suits_narrow_and_dark_screens(tmp_path: Path) -> None:
    write_page(summary(binding={"slip of a on tray": 0.25, "joint1 velocity": 0.75}), tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert '<meta name="viewport" content="width=device-width' in page
    assert "color-scheme: light dark" in page
    assert '<td><span>25.0 %</span><i style="--share: 0.250"></i></td>' in page
