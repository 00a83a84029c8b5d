"""What the planner's worker does: each job holds all that its plan depends on, as it was when planning began."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.task import Future

from jpap_ros.fleet.cells import Aircraft, FleetPlan
from jpap_ros.fleet.events import Events
from jpap_ros.fleet.plan import (
    SLOW_SCHEMES,
    Weighed,
    brought_up_to_date,
    full_deployment,
    plan_change,
    plan_from_scratch,
    weigh,
)
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.fleet.solver_process import Request
from jpap_ros.planning import Deployment
from jpap_ros.planning.devices import Device
from jpap_ros.planning.replanning_decision import ReplanningPolicy


@dataclass(frozen=True, eq=False)
class EventJob:
    """Answer events with a plan.

    Attributes
    ----------
    devices : tuple of Device
    settings : PlanSettings
    aircraft : tuple of Aircraft
    present : FleetPlan or None
        The plan in force.
    scratch : bool
        Whether to plan from the devices alone instead of changing the plan in force.
    policy : ReplanningPolicy
    events : Events
        What the plan answers.
    waiting : tuple of Future
        Operators who asked for a plan.
    first_event_s, started_s : float
        Monotonic times [s].
    """

    devices: tuple[Device, ...]
    settings: PlanSettings
    aircraft: tuple[Aircraft, ...]
    present: FleetPlan | None
    scratch: bool
    policy: ReplanningPolicy
    events: Events
    waiting: tuple[Future, ...]
    first_event_s: float
    started_s: float

    @property
    def request(self) -> Request:
        """What a plan from scratch for the same would be asked for."""
        return Request(self.devices, self.settings, sum(craft.available for craft in self.aircraft))

    @property
    def weighs(self) -> bool:
        """Whether this job itself weighs a plan from scratch: where one was asked for and is made quickly."""
        return bool(self.waiting) and self.settings.scheme not in SLOW_SCHEMES

    def run(self) -> tuple[FleetPlan, str]:
        """Return the plan, and what an operator may want to hear of how it came about."""
        if self.present is None or self.scratch:
            return plan_from_scratch(self.devices, self.settings, self.aircraft, self.present), ""
        changed = plan_change(self.devices, self.settings, self.aircraft, self.present)
        if not self.weighs:
            return changed, ""
        request = self.request
        full = full_deployment(request.devices, request.settings, request.uavs)
        weighed = weigh(full, self.devices, self.settings, self.aircraft, changed, self.policy)
        return weighed.plan, weighed.reason


@dataclass(frozen=True, eq=False)
class WeighJob:
    """Weigh a plan from scratch, made by the solver's process, against the plan in force.

    Attributes
    ----------
    full : Deployment
        The plan from scratch.
    made_for : Request
        What it was made for.
    request : Request
        What it would be made for now.
    aircraft, present, policy, started_s
        As for an EventJob.
    """

    full: Deployment
    made_for: Request
    request: Request
    aircraft: tuple[Aircraft, ...]
    present: FleetPlan
    policy: ReplanningPolicy
    started_s: float

    @property
    def late(self) -> bool:
        """Whether something has happened since the plan from scratch was asked for."""
        return self.made_for != self.request

    def run(self) -> Weighed:
        """Return the better plan."""
        now, full = self.request, self.full
        if self.late:
            full = brought_up_to_date(full, self.made_for.devices, now.devices, now.settings, now.uavs)
        return weigh(full, now.devices, now.settings, self.aircraft, self.present, self.policy)
