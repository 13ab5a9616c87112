"""The figures with which a build ends."""

import pytest

from phytac_design.cli import build_command
from phytac_design.report import verdict


def test_the_bound_is_quoted_at_a_force_of_the_design(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "decoded", lambda _: "")
    report = {
        "markers": {"count": 41},
        "visibility": {"occluded": 0, "fused": 0, "min_gap_px": 9.0},
        "under_load": {"sentence": ""},
        "resolution": {"bound": {"8 N": {"force_N_median": 0.8}, "10 N": {"force_N_median": 1.0}}},
    }
    words = build_command._verdict(report, 8.0)
    assert "8 N has at best a standard deviation of 0.80 N" in words
