"""Warnings as shaded bands over the panels of a plot."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from fusion.offline.warning_history import Warned

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOUR = "#F0E442"  # Okabe & Ito's yellow, which no curve has
LANES = 6  # labels below one another in the first panel; further ones could not be read
LANE = 0.075  # height of a label, of the first panel
LETTER = 0.0095  # width of a letter, of the panels


def shade_warnings(axes: Iterable[Axes], warnings: Iterable[Warned], start_ns: int) -> None:
    """Shade when each warning held through all panels, and write its code into the first.

    Parameters
    ----------
    axes : iterable of Axes
        The panels, top down; they share an axis of seconds since `start_ns`, whose limits are set.
    warnings : iterable of Warned
        Most serious first: of too many in one place, the least serious get no label.
    start_ns : int
        Start of the run, ns.
    """
    axes = list(axes)
    left, right = axes[0].get_xlim()
    lanes: list[list[tuple[float, float]]] = [[] for _ in range(LANES)]
    for one in warnings:
        bars = [((since - start_ns) * 1e-9, (until - since) * 1e-9) for since, until in one.spans]
        for axis in axes:
            _shade(axis, bars)
        _label(axes[0], one.warning.code, (bars[0][0] - left) / (right - left), lanes)


def _shade(axis: Axes, bars: list[tuple[float, float]]) -> None:
    """Shade bars (start, width) over the whole height of a panel, whose limits stay."""
    limits = axis.get_ylim()
    # the edge shows what is too short to be seen as an area
    look: dict[str, Any] = {"facecolor": (COLOUR, 0.18), "edgecolor": (COLOUR, 0.9), "linewidth": 0.6, "zorder": 0}
    axis.broken_barh(bars, (0.0, 1.0), transform=axis.get_xaxis_transform(), **look)
    axis.set_ylim(limits)


def _label(axis: Axes, code: str, begin: float, lanes: list[list[tuple[float, float]]]) -> None:
    """Write a code at `begin`, part of the panel's width, into the topmost lane that has room there."""
    width = LETTER * (len(code) + 1)
    begin = max(min(begin, 1.0 - width), 0.0)
    for number, taken in enumerate(lanes):
        if all(begin + width <= since or begin >= until for since, until in taken):
            taken.append((begin, begin + width))
            y, box = 1.0 - LANE * (number + 0.25), {"facecolor": (1.0, 1.0, 1.0, 0.7), "linewidth": 0.0, "pad": 1.0}
            axis.text(
                begin + 0.003, y, code, transform=axis.transAxes, va="top", fontsize=7, color="0.25", bbox=box, zorder=5
            )
            return
