"""P1 solved with proof: the smallest fleet, then the largest average UAV rate. Derived in docs/optimal.md."""

from jpap_ros.planning.optimal.scheme import improve, optimal

__all__ = ["improve", "optimal"]
