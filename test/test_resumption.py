"""What a bridge that was killed leaves to the next one, and what that does with it.

Oracle: the safety rules of DESIGN.md, stated in each test; the autopilot is the fake one of test_aircraft.py.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from test_aircraft import GUIDED, LOITER, ORIGIN, Rig

from jpap_ros.mavlink.flown_file import PLACES_EVERY_S, SUCCESSION_S, FlownFile, FlownFileError, Left
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.resumption import resume


class TestFlownFile:
    def test_the_next_one_reads_what_was_written_last(self, tmp_path: Path) -> None:
        path = tmp_path / "deep" / "flown.json"
        assert FlownFile(path).read() == Left()
        mine = FlownFile(path)
        mine.write(["uav2", "uav1"], {})
        line = ((1.5, -2.0, 50.0), (80.0, 0.0, 50.0))
        mine.write(["uav1"], {"uav2": line})
        assert FlownFile(path).read() == Left(("uav1",), {"uav2": line})
        assert [entry.name for entry in path.parent.iterdir()] == ["flown.json"], "no draft is left behind"

    def test_without_news_it_is_not_written_again(self, tmp_path: Path) -> None:
        mine = FlownFile(tmp_path / "flown.json")
        mine.write(["uav1"], {"uav1": ((0.0, 0.0, 50.0),)})
        (tmp_path / "flown.json").unlink()
        mine.write(["uav1"], {"uav1": ((0.0, 0.0, 50.0),)})
        assert not (tmp_path / "flown.json").exists()

    def test_places_are_written_now_and_then_and_a_departure_at_once(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        now = [100.0]
        monkeypatch.setattr(time, "monotonic", lambda: now[0])
        path = tmp_path / "flown.json"
        mine = FlownFile(path)
        mine.write(["uav1"], {"uav1": ((0.0, 0.0, 50.0),)})
        setting_out = {"uav1": ((0.0, 0.0, 50.0), (100.0, 0.0, 50.0))}
        mine.write(["uav1"], setting_out)
        assert FlownFile(path).read().in_air == setting_out
        on_its_way = {"uav1": ((8.0, 0.0, 50.0), (100.0, 0.0, 50.0))}
        mine.write(["uav1"], on_its_way)
        assert FlownFile(path).read().in_air == setting_out, "not at every position"
        now[0] += PLACES_EVERY_S
        mine.write(["uav1"], on_its_way)
        assert FlownFile(path).read().in_air == on_its_way
        path.unlink()
        now[0] += PLACES_EVERY_S
        mine.write(["uav1"], {"uav1": ((8.5, 0.0, 50.0), (100.0, 0.0, 50.0))})
        assert not path.exists(), "half a metre is the wind"

    @pytest.mark.parametrize("age_s", [SUCCESSION_S + 5.0, -60.0])
    def test_an_old_file_or_one_from_the_future_is_not_believed(self, tmp_path: Path, age_s: float) -> None:
        path = tmp_path / "flown.json"
        path.write_text(json.dumps({"version": 2, "written_at": time.time() - age_s, "flown": ["uav1"], "in_air": {}}))
        with pytest.raises(FlownFileError, match=r"flown\.json.*bridge/launch for uav1"):
            FlownFile(path).read()

    @pytest.mark.parametrize(
        "text",
        [
            "{",
            "[]",
            '{"version": 1, "written_at": 0, "flown": [], "in_air": {}}',
            '{"version": 2, "written_at": 0, "in_air": {}}',
            '{"version": 2, "written_at": 0, "flown": []}',
            '{"version": 2, "written_at": 0, "flown": [], "in_air": []}',
            '{"version": 2, "written_at": 0, "flown": [], "in_air": {"uav1": []}}',
            '{"version": 2, "written_at": 0, "flown": [], "in_air": {"uav1": [[0, 0, NaN]]}}',
            '{"version": 2, "written_at": 0, "flown": [], "in_air": {"uav1": [[0, 0]]}}',
        ],
    )
    def test_a_damaged_file_is_named(self, tmp_path: Path, text: str) -> None:
        path = tmp_path / "flown.json"
        path.write_text(text)
        with pytest.raises(FlownFileError, match=r"flown\.json"):
            FlownFile(path).read()

    def test_a_file_that_cannot_be_written_is_an_error(self, tmp_path: Path) -> None:
        (tmp_path / "file").write_text("")
        with pytest.raises(FlownFileError, match="cannot be written"):
            FlownFile(tmp_path / "file" / "flown.json").write(["uav1"], {})


def resumed(rig: Rig) -> Rig:
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.aircraft.run(resume(rig.aircraft), lambda ok, text: rig.done.append((ok, text)), "resume")
    return rig


def test_who_hovers_in_guided_flies_its_goal_again_and_no_command_is_sent() -> None:
    rig = resumed(Rig())
    rig.flying()
    rig.run(2.0)
    assert rig.done == [(True, "in the air as it was left; flies its goals again")]
    assert rig.goal[0] is GoalState.SENT
    orders = {mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_NAV_TAKEOFF}
    assert not orders & {m.command for m in rig.wire if m.get_type().startswith("COMMAND")}


def test_whom_a_pilot_took_meanwhile_is_the_pilots() -> None:
    rig = resumed(Rig())
    rig.mode = LOITER
    rig.flying()
    rig.run(2.0)
    assert rig.targets == [] and rig.goal[0] is GoalState.YIELDED
    assert "LOITER" in rig.goal[1] and "bridge/launch" in rig.goal[1]
    rig.mode = GUIDED
    rig.run(5.0)
    assert rig.targets == [], "not even when the pilot gives it back: an operator has to ask"


def test_who_stands_on_the_ground_stays_there() -> None:
    rig = resumed(Rig())
    rig.hear(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, 3, 0x01, GUIDED, 3, 3))
    rig.aircraft.tick(rig.now)
    assert rig.done == [(False, "not resumed: it is disarmed")]
    assert rig.targets == []


def test_who_climbs_is_left_alone_until_it_is_in_the_air() -> None:
    rig = resumed(Rig())
    rig.flying()
    rig.hear(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_TAKEOFF))
    rig.run(2.0, landed=False)
    assert rig.targets == [] and rig.done == []
    assert rig.aircraft.flown, "killed once more, it would still be left to the next one"
    rig.hear(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_IN_AIR))
    rig.run(1.0)
    assert rig.done[0][0] and rig.targets


def test_who_coasts_is_left_alone_until_it_rests() -> None:
    rig = resumed(Rig())
    rig.flying()
    lat, lon = LocalFrame(ORIGIN).to_geodetic(0.0, 0.0)
    here = round(rig.now * 1e3), round(lat * 1e7), round(lon * 1e7), 70_000, 50_000
    for north_cm_s, taken in ((800, False), (100, False), (40, True)):
        rig.hear(mavlink.MAVLink_global_position_int_message(*here, north_cm_s, 0, 0, 0))
        rig.aircraft.tick(rig.now)
        assert bool(rig.done) == taken, f"{north_cm_s / 100} m/s"


def test_who_is_not_heard_is_given_up_in_the_end() -> None:
    rig = resumed(Rig())
    for _ in range(700):
        rig.now += 0.1
        rig.aircraft.tick(rig.now)
    assert rig.done and not rig.done[0][0] and "not heard" in rig.done[0][1]
    rig.flying()
    rig.run(2.0)
    assert rig.targets == []


def test_who_was_left_in_the_air_is_there_until_it_says_itself_where_it_is() -> None:
    line = ((10.0, 0.0, 50.0), (90.0, 0.0, 50.0))
    rig = Rig()
    rig.aircraft.whereabouts.left_m = line
    silent = rig.aircraft.traveller()
    assert silent.flies and not silent.obeys and not silent.heard
    assert (silent.position, silent.way) == (line[0], line[1:])
    assert rig.aircraft.whereabouts.line_m(rig.aircraft.setpoint) == line, "killed once more, the next one knows too"
    rig.heartbeat()
    assert rig.aircraft.traveller().flies and rig.aircraft.traveller().position == line[0]
    rig.flying()
    heard = rig.aircraft.traveller()
    assert heard.position == pytest.approx((0.0, 0.0, 50.0), abs=0.1) and heard.way == ()
    assert rig.aircraft.whereabouts.left_m == ()


def test_who_was_left_in_the_air_and_is_found_on_the_ground_is_in_nobodys_way() -> None:
    rig = Rig()
    rig.aircraft.whereabouts.left_m = ((10.0, 0.0, 50.0),)
    rig.hear(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, 3, 0x01, GUIDED, 3, 3))
    assert not rig.aircraft.traveller().flies
    assert rig.aircraft.whereabouts.line_m(rig.aircraft.setpoint) == ()
