"""The planner node: from device reports to the deployment, goals and power allocations of a named fleet."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from jpap_msgs.msg import DeviceUpdate, GeoDeviceUpdate, VehicleState
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from jpap_ros.fleet.availability import Roster
from jpap_ros.fleet.bridge_watch import BridgeWatch
from jpap_ros.fleet.cells import Aircraft, FleetPlan
from jpap_ros.fleet.config import load_fleet
from jpap_ros.fleet.events import AircraftWatch, Events
from jpap_ros.fleet.handover import handed_over, moved_on
from jpap_ros.fleet.plan import SLOW_SCHEMES, Weighed, with_crew
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.fleet.plan_store import PlanStoreError, StoredPlan, load_plan, save_plan
from jpap_ros.fleet.solver_process import Request, SolverError, SolverProcess
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.nodes import planner_conversions as conversions
from jpap_ros.nodes.backlog import Backlog
from jpap_ros.nodes.debounce import Debounce
from jpap_ros.nodes.diagnostics import hardware_of, status_name
from jpap_ros.nodes.lifecycle import ManagedNode
from jpap_ros.nodes.parameters import StartError, declare, values
from jpap_ros.nodes.planner_diagnostics import PlannerHealth
from jpap_ros.nodes.planner_intake import DeviceIntake
from jpap_ros.nodes.planner_jobs import EventJob, WeighJob
from jpap_ros.nodes.planner_keeper import FleetKeeper, fleet_policy, relief_problem, vehicle_of
from jpap_ros.nodes.planner_outputs import PlannerOutputs
from jpap_ros.nodes.planner_parameters import (
    PLAN_PARAMETERS,
    plan_settings,
    planner_parameters,
    replanning_policy,
)
from jpap_ros.nodes.process import run
from jpap_ros.nodes.qos import DEVICES, LATCHED
from jpap_ros.nodes.worker import Worker
from jpap_ros.planning import Deployment
from jpap_ros.planning.devices import Changes, Device

#: How often the fleet's life is looked after, and whether those who wait for others may go [s].
_LIFE_PERIOD_S = 0.5

#: After a restart, how long to wait for the aircraft's states before the first plan [s]: DDS finds a killed node's
#: successor within a few seconds.
_SETTLE_S = 5.0
#: How often to look whether they have come [s].
_SETTLE_PERIOD_S = 0.1

#: At the end, how long to wait for a plan that is being made [s].
_STOP_PATIENCE_S = 2.0


def _run(job: EventJob | WeighJob) -> tuple[FleetPlan, str] | Weighed:
    return job.run()


class PlannerNode(ManagedNode):
    """Keeps the device table, plans in a worker when something happened, and publishes what comes out.

    Every accepted event is answered by a deployment whose reason names it, even where the plan stays the same: at once
    by the smallest change of the plan in force, then, where that is worth the flight, by a plan from scratch.
    """

    def __init__(self) -> None:
        # First, because rclpy destroys a node whose making was refused.
        self._worker: Worker[EventJob | WeighJob, tuple[FleetPlan, str] | Weighed] | None = None
        self._solver: SolverProcess | None = None
        super().__init__("planner")
        self._params = planner_parameters()
        declare(self, self._params, self._on_parameters)
        self._events = Events()
        #: What happened to aircraft before there was anything to serve: the first plan tells it.
        self._early = Events()
        self._watch = AircraftWatch(1.0)
        self._waiting: list[Future] = []
        self._first_event_s: float | None = None
        self._states: dict[str, VehicleState] = {}
        self._health = PlannerHealth()
        self._in_work: EventJob | WeighJob | None = None
        self._overdue = False
        self._solving = False
        #: A plan from scratch that waits to be weighed, and what it was made for.
        self._solved: tuple[Request, Deployment] | None = None
        #: What the plan in force was weighed for against a plan from scratch; a later change of it was not.
        self._weighed: Request | None = None
        self._planned_with: PlanSettings | None = None
        self._asked: list[Future] = []
        #: The plan of a planner before this one, until enough is known to go on from it.
        self._restored: StoredPlan | None = None
        self._settle_by_s = -math.inf
        self._backlog = Backlog()
        self._keeper: FleetKeeper | None = None
        self._roster: Roster | None = None
        self._bridge = BridgeWatch(time.monotonic())
        #: What the plan in force was made for, to tell and store it again between two plans.
        self._made_for: tuple[Sequence[Device], PlanSettings] | None = None
        #: Whom the state file knows as sent home.
        self._stored_home: frozenset[str] = frozenset()
        self._planned_for = 0
        self._made = ExitStack()

    # Transitions

    def configure(self) -> None:
        """Read the fleet file and begin to listen, so that no device event is lost before activation."""
        self._settings = values(self, self._params)
        self._fleet = load_fleet(self._settings["fleet_file"])
        local = LocalFrame(self._fleet.origin)
        self._intake = DeviceIntake(self._settings["map_frame"], local, self.get_logger().warning)
        self._outputs = PlannerOutputs(self, self._fleet.names)
        self._made.callback(self._outputs.close)
        self._restore()
        manages = self._settings["manage_fleet"]
        self._watch = AircraftWatch(None if manages else self._settings["low_battery"])
        self._bridge = BridgeWatch(time.monotonic())
        self._roster = None
        if manages:
            if problem := relief_problem(self._settings, self._fleet):
                raise StartError(problem)
            crew = self._health.plan.names if self._health.plan is not None else {}
            sent_home = self._restored.sent_home if self._restored is not None else ()
            self._keeper = FleetKeeper(self, self._fleet.names, fleet_policy(self._settings), crew, sent_home)
            self._made.callback(self._keeper.close)
            self.add_on_set_parameters_callback(self._refuse)
            self._made.callback(self.remove_on_set_parameters_callback, self._refuse)
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._made.callback(self.destroy_publisher, self._diagnostics_out)
        reporters = SubscriptionEventCallbacks(matched=self._on_reporter)
        self._subscribe(DeviceUpdate, "devices", self._on_devices, DEVICES, reporters)
        self._subscribe(GeoDeviceUpdate, "geo_devices", self._on_geo_devices, DEVICES, reporters)
        for name in self._fleet.names:
            self._subscribe(VehicleState, f"{name}/state", partial(self._on_state, name), LATCHED)
        # The answer waits for a plan: in a group of its own it holds up nothing else.
        group = ReentrantCallbackGroup()
        replan = self.create_service(Trigger, "planner/replan", self._on_replan, callback_group=group)
        self._made.callback(self.destroy_service, replan)
        # Steady time: diagnostics and the fleet's life go on while a simulated clock stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._quiet = Debounce(self, self._on_quiet)
        every_second = self.create_timer(1.0, self._on_second, clock=steady)
        self._result = self.create_guard_condition(self._on_result)
        self._made.callback(self._quiet.close)
        self._made.callback(self.destroy_timer, every_second)
        self._made.callback(self.destroy_timer, self.create_timer(_LIFE_PERIOD_S, self._on_life, clock=steady))
        self._answer = self.create_guard_condition(self._on_solved)
        self._made.callback(self.destroy_guard_condition, self._result)
        self._made.callback(self.destroy_guard_condition, self._answer)

    def _restore(self) -> None:
        """Go on with the plan that a planner before this one has left."""
        if not self._settings["state_file"]:
            return
        try:
            stored = load_plan(Path(self._settings["state_file"]), self._fleet.origin)
        except PlanStoreError as error:
            self.get_logger().warning(f"starting afresh: {error}")
            return
        if stored is None:
            return
        self._intake.restore(stored.devices, stored.stamps)
        self._health.plan_id, self._planned_with = stored.plan_id, stored.settings
        self._health.plan = stored.plan(self._all_aircraft())
        self._restored = stored
        self._events.add(f"planner restarted, going on from plan {stored.plan_id}")

    def _settled(self) -> bool:
        """Whether planning may begin: after a restart, once every aircraft has said what it follows, or some time."""
        restored = self._restored
        if restored is not None:
            # A bridge that has just started has heard of nobody yet.
            heard = sum(state.link == VehicleState.LINK_CONNECTED for state in self._states.values())
            if heard < len(self._fleet.names) and time.monotonic() < self._settle_by_s:
                return False
            self._restored = None
            self._go_on_from(restored)
        if self._keeper is not None and self._roster is None:
            # Without it no aircraft could be given a cell.
            for event in self._keep_fleet(self._health.plan).events:
                self._events.add(event)
        return True

    def _go_on_from(self, restored: StoredPlan) -> None:
        """Keep the plan of the state file in force, by other names if it is out of date."""
        if self._health.plan_id > restored.plan_id:
            news = f"aircraft follow plan {self._health.plan_id}, newer than plan {restored.plan_id} of the state file"
            self.get_logger().warning(f"{news}: its cells go to whoever is nearest")
            self._events.add(news)
            self._health.plan = restored.renamed(self._all_aircraft())
            if self._keeper is not None:
                self._keeper.forget_crew()

    def _store(self, plan: FleetPlan, devices: Sequence[Device], settings: PlanSettings) -> None:
        if not self._settings["state_file"]:
            return
        path, stamps = Path(self._settings["state_file"]), self._intake.stamps
        self._stored_home = self._keeper.sent_home if self._keeper is not None else frozenset()
        try:
            save_plan(
                path, self._fleet.origin, self._health.plan_id, devices, settings, plan, stamps, self._stored_home
            )
        except PlanStoreError as error:
            self.get_logger().error(str(error), throttle_duration_sec=60.0)

    def activate(self) -> None:
        """Plan for what is known already."""
        self._worker = Worker("planning", _run, self._result.trigger)
        self._solver = SolverProcess(self._answer.trigger)
        topics = " and ".join(self.resolve_topic_name(topic) for topic in ("devices", "geo_devices"))
        self.get_logger().info(
            f"listening to {topics}; {len(self._fleet.names)} UAVs of {self._settings['fleet_file']}, "
            f"scheme {self._settings['scheme']}"
        )
        self._settle_by_s = time.monotonic() + _SETTLE_S
        if self._events:
            self._touch()

    def deactivate(self) -> None:
        """Stop planning; go on listening."""
        self._stop_worker()

    def cleanup(self) -> None:
        """Stop listening and forget everything."""
        self._made.close()
        self._events, self._early = Events(), Events()
        self._states.clear()
        self._health = PlannerHealth(plan_id=self._health.plan_id)
        self._weighed = self._planned_with = self._restored = self._made_for = self._solved = None

    def destroy_node(self) -> None:
        """Stop planning and leave the graph."""
        self._stop_worker()
        super().destroy_node()

    # Events

    def _on_reporter(self, matched: QoSSubscriptionMatchedInfo) -> None:
        if matched.current_count_change > 0:
            self._backlog.found(time.monotonic())

    def _on_devices(self, message: DeviceUpdate) -> None:
        self._answer_changes(self._intake.take(message))

    def _on_geo_devices(self, message: GeoDeviceUpdate) -> None:
        self._answer_changes(self._intake.take_geo(message))

    def _answer_changes(self, changes: Changes) -> None:
        self._backlog.heard(time.monotonic())
        if changes:
            self._events.add_changes(changes)
            self._touch()

    def _on_state(self, name: str, state: VehicleState) -> None:
        now = time.monotonic()
        if self._health.bridge_silent_s:
            self.get_logger().info(f"the bridge is heard again after {self._bridge.silent_s(now):.0f} s")
            self._health.bridge_silent_s = 0.0
        self._bridge.hear(now)
        before = self._aircraft(name)
        self._states[name] = state
        after = self._aircraft(name)
        # A restarted planner counts on from the plans that aircraft still follow.
        self._health.plan_id = max(self._health.plan_id, state.goal_plan_id)
        if before.connected != after.connected:
            self.get_logger().info(f"{name} is {'heard' if after.connected else 'no longer heard'}")
        news = Events()
        happened = self._watch.take(vehicle_of(name, state, sent_home=False), news)
        if before.available != after.available and self._keeper is None:
            self.get_logger().info(f"{name} {after.unavailable or 'is available'}")
            news.add(f"{name} {after.unavailable or 'is available'}")
            happened = True
        if happened:
            self._answer_fleet(news)

    def _bridge_silent_s(self, now_s: float) -> float:
        """How long the bridge has been silent [s]; 0 where there may be none, as far as known."""
        return self._bridge.silent_s(now_s) if self._states or self._keeper is not None else 0.0

    def _answer_fleet(self, news: Events) -> None:
        """Plan anew for what happened to aircraft; without a plan there is nothing to change."""
        if self._health.plan is None and self._in_work is None and not self._events:
            news.merge(self._early)
            self._early = news
            return
        news.merge(self._events)
        self._events = news
        self._touch()

    def _on_life(self) -> None:
        """Look after the fleet, and let those go who wait no longer."""
        if not self.active or self._restored is not None:
            return
        if self._keeper is not None:
            self._look_after_fleet(self._keeper)
        self._let_go()

    def _let_go(self) -> None:
        """Tell the plan in force anew once aircraft that waited for others need not any more."""
        told, plan = self._health.plan, self._present()
        if told is None or plan is None or self._in_work is not None or self._made_for is None:
            return
        devices, settings = self._made_for
        if (now := moved_on(told, plan, self._all_aircraft(), settings)) is not None:
            gone = [name for name in told.waiting if name not in now.waiting]
            reason = f"{conversions.listed(gone)} waited for others, which serve now" if gone else "devices taken over"
            self._publish(now, reason, devices, settings, time.monotonic())

    def _present(self) -> FleetPlan | None:
        """The plan in force with who flies it now."""
        plan = self._health.plan
        return with_crew(plan, self._roster.crew) if plan is not None and self._roster is not None else plan

    def _look_after_fleet(self, keeper: FleetKeeper) -> None:
        """Plan anew where the fleet's life changes what can be served."""
        roster, plan = self._keep_fleet(self._health.plan), self._health.plan
        news = list(roster.events)
        changed = roster.usable != self._planned_for
        if plan is not None and changed and (plan.uavs_needed > len(plan.target) or roster.usable < len(plan.target)):
            news.append(f"{roster.usable} aircraft are usable")
        if plan is not None and self._made_for is not None and keeper.sent_home != self._stored_home:
            self._store(plan, *self._made_for)
        if news:
            told = Events()
            for event in news:
                told.add(event)
            self._answer_fleet(told)

    def _keep_fleet(self, plan: FleetPlan | None) -> Roster:
        assert self._keeper is not None
        altitude_m = self._settings["altitude_m"]
        now_s = self._bridge.clock(time.monotonic())
        self._roster = self._keeper.step(now_s, self._states, plan, self._intake.devices, altitude_m)
        return self._roster

    def _refuse(self, parameters: list[Parameter]) -> SetParametersResult:
        problem = relief_problem({**self._settings, **{p.name: p.value for p in parameters}}, self._fleet)
        return SetParametersResult(successful=problem is None, reason=problem or "")

    def _on_parameters(self, changed: dict[str, Any]) -> None:
        self._settings = values(self, self._params)
        if self._keeper is not None:
            self._keeper.assign_by(self._settings["assignment"])
        names = sorted(PLAN_PARAMETERS & changed.keys())
        if names and (self._health.plan is not None or self._in_work is not None):
            for name in names:
                self._events.add(f"parameter {name} is now {changed[name]}")
            self._touch()

    async def _on_replan(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self.active:
            response.message = "the planner is not active"
            return response
        answer: Future = Future()
        self._waiting.append(answer)
        self._events.add("operator asked")
        self._touch(at_once=True)
        response.success, response.message = await answer
        return response

    def _on_second(self) -> None:
        timeout_s = self._settings["device_timeout_s"]
        if timeout_s and (silent := self._intake.expire(timeout_s)):
            self.get_logger().info(f"no report for {timeout_s:g} s, taken as left: {conversions.listed(silent)}")
            self._events.add_silent(len(silent))
            self._touch()
        health, now = self._health, time.monotonic()
        silent_s = self._bridge_silent_s(now)
        if silent_s and not health.bridge_silent_s:
            self.get_logger().warning(
                f"bridge silent: no aircraft's state for {silent_s:.0f} s; nobody is given up for it"
            )
        health.bridge_silent_s = silent_s
        health.relief_problem = self._keeper.problem if self._keeper is not None else ""
        health.active = self.active
        health.pending = self._in_work is not None or bool(self._events)
        health.devices, health.ignored = len(self._intake.devices), self._intake.ignored
        health.faults = self._intake.faults
        health.fleet = len(self._fleet.names)
        health.available = sum(craft.available for craft in self._all_aircraft())
        name = status_name(self.get_fully_qualified_name(), "deployment")
        status = health.status(name, now, hardware_of(self._settings["fleet_file"]))
        self._diagnostics_out.publish(DiagnosticArray(header=self._header(), status=[status]))

    # Planning

    def _touch(self, at_once: bool = False) -> None:
        """Plan once events have stopped coming, or when the first of them has waited for long enough."""
        self._events.merge(self._early)
        self._early = Events()
        if self._first_event_s is None:
            self._first_event_s = time.monotonic()
        if self.active:
            quiet_s = 0.0 if at_once else self._settings["debounce_s"]
            self._quiet.touch(self._first_event_s, quiet_s, self._settings["debounce_max_s"])

    def _on_quiet(self) -> None:
        if not self.active or not self._events:
            return
        if (left_s := self._backlog.left_s(time.monotonic())) > 0.0:
            self._quiet.touch(time.monotonic(), left_s, left_s)
            return
        if not self._settled():
            self._quiet.touch(time.monotonic(), _SETTLE_PERIOD_S, _SETTLE_PERIOD_S)
            return
        if self._in_work is not None:
            self._overdue = True
            return
        assert self._worker is not None and self._first_event_s is not None
        settings = plan_settings(self._settings)
        job = EventJob(
            devices=self._intake.devices,
            settings=settings,
            aircraft=self._all_aircraft(),
            present=self._present(),
            scratch=self._settings["replanning"] == "scratch" or settings != self._planned_with,
            policy=replanning_policy(self._settings),
            events=self._events,
            waiting=tuple(self._waiting),
            first_event_s=self._first_event_s,
            started_s=time.monotonic(),
        )
        self._events, self._waiting, self._first_event_s = Events(), [], None
        self._in_work, self._overdue = job, False
        self._planned_for = job.request.uavs
        self._worker.submit(job)

    def _on_result(self) -> None:
        if self._worker is None or (finished := self._worker.take()) is None:
            return
        job, result = finished
        self._in_work = None
        if isinstance(job, WeighJob):
            self._after_weighing(job, result)
        elif isinstance(result, Exception):
            self._keep(job, result)
        else:
            self._after_planning(job, *result)
        if self._overdue:
            self._on_quiet()
        self._reoptimise()

    def _keep(self, job: EventJob, error: Exception) -> None:
        """Planning failed: the last good plan stays in force, and the next one answers for these events too."""
        self._events.merge(job.events)
        self._first_event_s = job.first_event_s
        failure = str(error) if isinstance(error, ValueError) else repr(error)
        message = f"planning failed, the last good plan stays in force: {failure}"
        self.get_logger().error(message)
        if job.present is not None and not job.scratch:
            # Perhaps it is the plan in force that cannot be changed: forget how it was made.
            self._planned_with = None
            self._waiting.extend(job.waiting)
            self._overdue = True
        else:
            self._health.failure = failure
            self._tell(job.waiting, False, message)

    def _after_planning(self, job: EventJob, plan: FleetPlan, how: str) -> None:
        before, self._planned_with = self._health.plan, job.settings
        self._publish(plan, str(job.events), job.devices, job.settings, job.started_s)
        self._health.latency_s = time.monotonic() - job.first_event_s
        self._warn_unserved(job.devices, plan, before)
        # A change carries no proof, not even one for the same request, as when an aircraft joins that was counted on.
        self._weighed = job.request if plan.from_scratch or job.weighs else None
        if job.settings.scheme in SLOW_SCHEMES and job.waiting:
            # The answer is the plan from scratch, which the solver's process makes.
            self._asked.extend(job.waiting)
        else:
            self._tell(job.waiting, True, f"plan {self._health.plan_id}: {plan.summary()}" + (how and f"; {how}"))

    # Plans from scratch

    def _reoptimise(self) -> None:
        """Have a plan made from scratch for what the plan in force was made for, unless that was done."""
        if self._solver is None or self._health.plan is None or self._in_work is not None or self._events:
            return
        request = self._request()
        if self._solved is not None and self._solved[0].settings == request.settings:
            self._weigh(*self._solved, request)
            return
        self._solved = None
        if self._solving or not (self._settings["reoptimise"] or self._asked):
            return
        if request != self._weighed:
            self._solving = True
            self._solver.submit(request)

    def _on_solved(self) -> None:
        if self._solver is None or (finished := self._solver.take()) is None:
            return
        request, full = finished
        self._solving = False
        if isinstance(full, SolverError):
            self.get_logger().error(f"no plan from scratch: {full}")
            self._weighed = request
            self._tell_asked(False, f"no plan from scratch: {full}")
        else:
            # What is being planned now comes first.
            self._solved = request, full
            self._reoptimise()

    def _weigh(self, made_for: Request, full: Deployment, request: Request) -> None:
        assert self._worker is not None and self._health.plan is not None
        self._solved = None
        self._in_work = WeighJob(
            full=full,
            made_for=made_for,
            request=request,
            aircraft=self._all_aircraft(),
            present=self._health.plan,
            policy=replanning_policy(self._settings),
            started_s=time.monotonic(),
        )
        self._worker.submit(self._in_work)

    def _after_weighing(self, job: WeighJob, result: tuple[FleetPlan, str] | Weighed | Exception) -> None:
        if not job.late:
            self._weighed = job.request
        if not isinstance(result, Weighed):
            self.get_logger().error(f"no plan from scratch: {result!r}")
            self._tell_asked(False, f"no plan from scratch: {result!r}")
            return
        if job.late and not result.adopted:
            # It says nothing of what is asked for now; the next one will.
            return
        proven = (result.plan.min_uavs_bound, result.plan.proven_optimal)
        news = proven != (job.present.min_uavs_bound, job.present.proven_optimal)
        if result.adopted or news:
            reason = f"plan from scratch: {result.reason}" if result.adopted else "bound proven, the same plan"
            self._publish(result.plan, reason, job.request.devices, job.request.settings, job.started_s)
            self._warn_unserved(job.request.devices, result.plan, job.present)
        else:
            self.get_logger().debug(f"plan from scratch not flown: {result.reason}")
        self._tell_asked(True, f"plan {self._health.plan_id}: {result.plan.summary()}; {result.reason}")

    def _request(self) -> Request:
        """What a plan from scratch would be asked for now."""
        available = sum(craft.available for craft in self._all_aircraft())
        return Request(self._intake.devices, plan_settings(self._settings), available)

    def _tell_asked(self, success: bool, message: str) -> None:
        self._tell(self._asked, success, message)
        self._asked = []

    # Out

    def _publish(
        self, plan: FleetPlan, reason: str, devices: Sequence[Device], settings: PlanSettings, started_s: float
    ) -> None:
        health = self._health
        health.plan_id += 1
        roster = None
        if self._keeper is not None:
            roster = self._keep_fleet(plan)
            plan = with_crew(plan, roster.crew)
            reason = ", ".join([reason, *(event for event in roster.events if event not in reason)])
        # Against what the radios were last told, for who flies now and from where.
        plan = handed_over(health.plan, plan, self._all_aircraft(), settings)
        above_m = settings.link.altitude_m + self._settings["station_above_m"]
        waiting = roster.reliefs if roster is not None else {}
        reliefs = {waiting[cell.id]: (*cell.position, above_m) for cell in plan.cells if cell.id in waiting}
        newly = plan.interrupted.keys() - (health.plan.interrupted if health.plan is not None else {})
        self._made_for = devices, settings
        # What anybody was told must survive a kill.
        self._store(plan, devices, settings)
        now = time.monotonic()
        altitude_m = settings.link.altitude_m
        self._outputs.publish(
            plan, health.plan, self._header(), health.plan_id, reason, altitude_m, now - started_s, reliefs
        )
        health.plan, health.plan_made_s, health.planning_s, health.failure = plan, now, now - started_s, ""
        self.get_logger().info(
            f"plan {health.plan_id} ({reason}): {plan.summary()}; planned in {health.planning_s * 1e3:.1f} ms"
        )
        if newly:
            self.get_logger().warning(
                "interrupted on the way: "
                + conversions.listed(f"device {name!r}: {plan.interrupted[name]}" for name in sorted(newly))
            )

    def _warn_unserved(self, devices: Iterable[Device], plan: FleetPlan, before: FleetPlan | None) -> None:
        """Name each device that is newly left out, with its demand, once."""
        known = before.unserved if before is not None else {}
        demand = {device.id: device.rate_demand for device in devices}
        new = [
            f"device {name!r}: rate_demand {demand[name]:.6g} bit/s: {reason}"
            for name, reason in plan.unserved.items()
            if known.get(name) != reason
        ]
        if new:
            self.get_logger().warning(f"not served: {conversions.listed(new)}")

    def _tell(self, waiting: Iterable[Future], success: bool, message: str) -> None:
        for future in waiting:
            future.set_result((success, message))

    def _stop_worker(self) -> None:
        if self._worker is None:
            return
        if not self._worker.stop(_STOP_PATIENCE_S):
            self.get_logger().warning(f"planning did not end within {_STOP_PATIENCE_S:g} s; its result is dropped")
        self._worker = None
        self._quiet.cancel()
        if isinstance(self._in_work, EventJob):
            self._events.merge(self._in_work.events)
            self._waiting.extend(self._in_work.waiting)
        self._in_work = None
        self._overdue = False
        if self._solver is not None:
            self._solver.close()
            self._solver = None
        self._solving, self._solved = False, None
        self._tell([*self._waiting, *self._asked], False, "the planner was deactivated")
        self._waiting, self._asked = [], []

    # The rest

    def _aircraft(self, name: str) -> Aircraft:
        plan = self._health.plan
        goal = next((cell for cell in plan.cells if cell.uav == name), None) if plan is not None else None
        craft = conversions.aircraft_of(self._fleet[name], self._states.get(name), goal)
        if self._keeper is None:
            return craft
        usable = self._roster is not None and (name in self._roster.crew.values() or name in self._roster.free)
        return replace(craft, unavailable="" if usable else "cannot be given a cell now")

    def _all_aircraft(self) -> tuple[Aircraft, ...]:
        return tuple(self._aircraft(name) for name in self._fleet.names)

    def _header(self) -> Header:
        return Header(stamp=self.get_clock().now().to_msg(), frame_id=self._settings["map_frame"])

    def _subscribe(
        self, kind: type, topic: str, callback: Any, qos: QoSProfile, events: SubscriptionEventCallbacks | None = None
    ) -> None:
        subscription = self.create_subscription(kind, topic, callback, qos, event_callbacks=events)
        self._made.callback(self.destroy_subscription, subscription)


def make_planner() -> PlannerNode:
    """Make the node; bring it up unless its parameter `autostart` is false."""
    node = PlannerNode()
    if node.get_parameter("autostart").value:
        node.bring_up()
    return node


def main() -> None:
    """Run the planner as a process."""
    # Events are answered while the worker computes: they wait for the interpreter this long, not the usual 5 ms.
    sys.setswitchinterval(5e-4)
    sys.exit(run(make_planner))
