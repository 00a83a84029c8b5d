"""One look for every figure: colours that colour-blind readers tell apart, and how each scheme is drawn."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

#: Okabe and Ito's palette.
BLUE, ORANGE, GREEN, VERMILLION, PURPLE, BLACK, GREY = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#000000",
    "#8A8A8A",
)


#: Formats, and what is left out of each so that the same data give the same file.
METADATA: dict[str, dict[str, None]] = {".png": {"Software": None}, ".svg": {"Date": None}}


class Look(NamedTuple):
    """How a scheme is named and drawn: colour by placement; line and filling by power allocation.

    The spiral's lines are wider, as they run so close to JPAP's that one would hide the other.
    """

    label: str
    colour: str
    line: str
    marker: str
    filled: bool
    width: float = 1.3

    @property
    def face(self) -> str:
        """Colour of the marker's inside."""
        return self.colour if self.filled else "white"


LOOKS = {
    "jpap": Look("JPAP (QDPA)", BLUE, "-", "*", True),
    "jpap_epa": Look("EPA-JPAP, own radii", VERMILLION, "--", "s", False),
    "jpap_epa_common": Look("EPA-JPAP, common radius", VERMILLION, ":", "D", False),
    "spiral_qdpa": Look("Spiral, QDPA", GREEN, "-", "o", True, 3.2),
    "spiral_epa": Look("Spiral, EPA", GREEN, "--", "o", False, 3.2),
    "kmeans_qdpa": Look("K-means, QDPA", ORANGE, "-", "^", True),
    "kmeans_epa": Look("K-means, EPA", ORANGE, "--", "^", False),
    "optimal": Look("Optimal (proven)", BLACK, "-.", "x", True),
}


def look(scheme: str) -> Look:
    """How to draw a scheme; a scheme without a look of its own gets a plain one under its name."""
    return LOOKS.get(scheme, Look(scheme, GREY, "-", ".", True))


def scheme_order(scheme: str) -> int:
    """Place of a scheme in tables and legends."""
    names = list(LOOKS)
    return names.index(scheme) if scheme in LOOKS else len(names)


@contextmanager
def figure_style() -> Iterator[None]:
    """Settings within which the figures are drawn."""
    settings: dict[Any, Any] = {
        "figure.dpi": 100,
        "savefig.dpi": 200,
        "font.size": 9,
        "axes.titlesize": 9,
        "axes.labelsize": 9,
        "legend.fontsize": 8,
        "axes.grid": True,
        "grid.color": "#DDDDDD",
        "grid.linewidth": 0.6,
        "axes.axisbelow": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "lines.linewidth": 1.4,
        "lines.markersize": 5.5,
        "legend.frameon": False,
        # The same data give the same file, and text stays text.
        "svg.hashsalt": "jpap_ros",
        "svg.fonttype": "none",
    }
    with plt.rc_context(settings):
        yield


def save(figure: Figure, path: Path) -> list[Path]:
    """Write a figure as PNG and SVG beside each other and close it; return the two paths."""
    paths = [path.with_suffix(suffix) for suffix in METADATA]
    for each in paths:
        write(figure, each)
    plt.close(figure)
    return paths


def write(figure: Figure, path: Path) -> None:
    """Write a figure as what its suffix says, `.png` or `.svg`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, bbox_inches="tight", metadata=METADATA[path.suffix.lower()])
