"""The registry of schemes: name to algorithm."""

from __future__ import annotations

from jpap_ros.planning.jpap import jpap, jpap_epa, jpap_epa_common
from jpap_ros.planning.kmeans import kmeans_epa, kmeans_qdpa
from jpap_ros.planning.optimal import optimal
from jpap_ros.planning.solver import Scheme
from jpap_ros.planning.spiral import spiral_epa, spiral_qdpa

#: Every scheme by its name, in the order in which comparisons show them.
SCHEMES: dict[str, Scheme] = {
    "jpap": jpap,
    "jpap_epa": jpap_epa,
    "jpap_epa_common": jpap_epa_common,
    "kmeans_qdpa": kmeans_qdpa,
    "kmeans_epa": kmeans_epa,
    "spiral_qdpa": spiral_qdpa,
    "spiral_epa": spiral_epa,
    "optimal": optimal,
}
