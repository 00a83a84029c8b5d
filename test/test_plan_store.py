"""The plan in a file. Oracle: the plan that was stored; and files damaged by hand."""

import json
from dataclasses import replace

import pytest

from jpap_ros.fleet.cells import Aircraft
from jpap_ros.fleet.config import MapOrigin
from jpap_ros.fleet.plan import plan_change, plan_from_scratch
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.fleet.plan_store import PlanStoreError, load_plan, save_plan
from jpap_ros.planning import LinkBudget
from jpap_ros.planning.devices import Device

ORIGIN = MapOrigin(-37.8, 145.0, 20.0)
SETTINGS = PlanSettings(link=LinkBudget(altitude_m=60.0), bandwidth_hz=2.0, max_devices_per_uav=3)
FLEET = [Aircraft(f"u{i}", (10.0 * i, 0.0)) for i in range(6)]
DEVICES = (
    Device("a", (0.1, 0.2), 32.0),
    Device("b", (31.7, -5.0), 31.0, 2.0),
    Device("c", (900.0, 1.0 / 3.0), 34.0),
    Device("greedy", (0.0, 0.0), 90.0),
)


@pytest.fixture
def stored(tmp_path):
    """Return the file and the plan in it."""
    plan = plan_from_scratch(DEVICES, SETTINGS, FLEET)
    save_plan(tmp_path / "deep" / "plan.json", ORIGIN, 17, DEVICES, SETTINGS, plan, {"a": 3}, {"u5"})
    return tmp_path / "deep" / "plan.json", plan


def test_what_is_read_is_what_was_written_to_the_last_bit(stored):
    path, plan = stored
    read = load_plan(path, ORIGIN)
    assert (read.plan_id, read.devices, read.settings) == (17, DEVICES, SETTINGS)
    again = read.plan(FLEET)
    assert again.cells == plan.cells and again.names == plan.names
    assert dict(again.unserved) == dict(plan.unserved) and again.uavs_needed == plan.uavs_needed
    assert again.live.next_id == plan.live.next_id
    assert (read.stamps, read.sent_home) == ({"a": 3}, {"u5"})


def test_a_file_without_stamps_and_those_sent_home_is_read_too(stored):
    path = stored[0]
    path.write_text(damaged(lambda c: (c.pop("stamps"), c.pop("sent_home")))(path.read_text()))
    read = load_plan(path, ORIGIN)
    assert (read.plan_id, read.stamps, read.sent_home) == (17, {}, frozenset())


def test_aircraft_that_wait_still_do_so_after_a_restart(stored):
    """One goes on with its powers, one with its place and devices, and one whose cell is no more is still there."""
    path, plan = stored
    powers = replace(plan.cells[0], apply_within_m=12.5, power_until_w=(("a", 4.0),), elsewhere=frozenset("a"))
    free = next(craft.name for craft in FLEET if craft.name not in plan.names.values())
    place = replace(
        plan.cells[1], position=(70.0, 80.0), device_ids=("b",), power_w=(3.0,), rate=(4.0,), waits_for=("u1",)
    )
    left = replace(plan.cells[0], id=99, uav=free, waits_for=("u1",))
    now = replace(plan, cells=(powers, place, *plan.cells[2:], left))
    save_plan(path, ORIGIN, 18, DEVICES, SETTINGS, now)
    again = load_plan(path, ORIGIN).plan(FLEET)
    assert again.cells == now.cells and again.target == plan.target and again.waiting == now.waiting


def test_planning_goes_on_as_if_nothing_had_happened(stored):
    path, plan = stored
    again = load_plan(path, ORIGIN).plan(FLEET)
    assert plan_change(DEVICES, SETTINGS, FLEET, again).cells == plan.cells
    joined = (*DEVICES, Device("new", (20.0, 0.0), 30.0))
    assert plan_change(joined, SETTINGS, FLEET, again).cells == plan_change(joined, SETTINGS, FLEET, plan).cells


def test_an_aircraft_that_left_the_fleet_leaves_its_cell_without_a_name(stored):
    path, plan = stored
    gone = plan.cells[0].uav
    again = load_plan(path, ORIGIN).plan([craft for craft in FLEET if craft.name != gone])
    assert gone not in again.names.values()
    assert len(again.cells) == len(plan.cells) and len(again.names) == len(plan.names) - 1


def test_without_a_file_there_is_no_plan(tmp_path):
    assert load_plan(tmp_path / "nowhere.json", ORIGIN) is None


def test_a_plan_of_another_map_is_refused(stored):
    with pytest.raises(PlanStoreError, match="origin"):
        load_plan(stored[0], MapOrigin(-37.9, 145.0, 20.0))


def damaged(change):
    def damage(text):
        content = json.loads(text)
        change(content)
        return json.dumps(content)

    return damage


DAMAGE = {
    "empty": lambda text: "",
    "cut": lambda text: text[: len(text) // 2],
    "not a mapping": lambda text: "[1, 2]",
    "version": damaged(lambda c: c.update(version=99)),
    "key": damaged(lambda c: c.pop("cells")),
    "device": damaged(lambda c: c["devices"][0].update(rate_demand=-1.0)),
    "unknown device in a cell": damaged(lambda c: c["cells"][0]["device_ids"].__setitem__(0, "nobody")),
    "power": damaged(lambda c: c["cells"][0]["power_w"].__setitem__(0, 1e-6)),
    "told": damaged(lambda c: c["told"].append({"id": 0})),
    "setting": damaged(lambda c: c["settings"].update(colour="red")),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE.keys())
def test_a_damaged_file_is_refused_with_its_name(stored, damage):
    path = stored[0]
    path.write_text(damage(path.read_text()))
    with pytest.raises(PlanStoreError, match=r"plan\.json"):
        load_plan(path, ORIGIN)


def test_a_file_that_cannot_be_written_is_an_error(stored, tmp_path):
    with pytest.raises(PlanStoreError, match="cannot be written"):
        save_plan(stored[0] / "below_a_file", ORIGIN, 1, DEVICES, SETTINGS, stored[1])


def test_nothing_but_the_file_is_left_behind(stored):
    assert [path.name for path in stored[0].parent.iterdir()] == ["plan.json"]


def test_cells_can_be_given_to_those_that_are_nearest_now(stored):
    # Oracle: each aircraft hovers in a cell; whoever that is takes it, whatever the file says.
    path, plan = stored
    there = [Aircraft(f"v{i}", cell.position) for i, cell in enumerate(reversed(plan.cells))]
    renamed = load_plan(path, ORIGIN).renamed([*FLEET, *there])
    assert {cell.uav: cell.position for cell in renamed.cells} == {craft.name: craft.position for craft in there}
