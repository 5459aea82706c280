"""Layups that no user means."""

from __future__ import annotations

from typing import Final

from hypothesis import strategies as st

__all__ = ["layups"]


_PLIES: Final = st.one_of(
    st.floats(-100, 100).map(lambda angle: f"{angle:g}"),
    st.integers(-90, 90).map(str),
    st.sampled_from(("?", "±45", "-+30", "+-0", "", "90.", ".5", "1e3", "٣")),
)
_COUNTS: Final = st.one_of(
    st.just(""), st.integers(0, 3000).map(lambda n: f"_{n}"), st.just("_"), st.just("2")
)


def _run(plies: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    item = st.tuples(plies, _COUNTS).map("".join)
    return st.lists(item, max_size=5).map("/".join)


_GROUPS: Final = st.recursive(
    _run(_PLIES), lambda inner: _run(inner.map(lambda run: f"({run})")), max_leaves=6
)
_ENDS: Final = st.sampled_from(("]", "]_s", "]s", "]_2s", "]_T", "]_99999999999s", "", "]]", "]_", "] x"))


def layups() -> st.SearchStrategy[str]:
    """Layups of the notation, most of them wrong somewhere, and texts of its characters."""
    return st.one_of(
        st.tuples(st.just("["), _GROUPS, _ENDS).map("".join),
        st.text(alphabet="[]()/_0123456789.?+-±∓sST ", max_size=60),
        st.text(max_size=40),
    )
