"""What pages send, sense and nonsense; and who may send it.

Oracle: the contract of each field, and Python's own JSON writer for nonsense of every shape.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.dashboard.access import Access, AccessError, load_token
from jpap_ros.dashboard.requests import (
    OrderRequest,
    PutDevice,
    RemoveDevice,
    ReplanRequest,
    RequestError,
    read_hello,
    read_object,
    read_request,
)
from jpap_ros.planning.devices import Device

UAVS = ["uav1", "uav2"]
TOKEN = "correct horse battery"


def read(exercise: bool = True, **fields):
    return read_request({"type": "request", "id": 1, **fields}, UAVS, exercise)


def device(**fields):
    return {"action": "put_device", "device": {"id": "a", "x": 1, "y": 2.5, "demand": 14, **fields}}


class TestRequests:
    def test_what_may_be_asked_for(self) -> None:
        assert read(action="launch", uavs=["uav2", "uav1", "uav2"]) == OrderRequest("launch", ("uav2", "uav1"))
        assert read(action="replan") == ReplanRequest()
        assert read(**device()) == PutDevice(Device("a", (1.0, 2.5), 14.0, 1.0))
        assert read(action="remove_device", device="a") == RemoveDevice("a")

    @pytest.mark.parametrize(
        ("fields", "says"),
        [
            ({"action": "explode"}, "action must be one of launch, .*; got 'explode'"),
            ({"action": ["launch"]}, "action must be one of"),
            ({"action": "launch"}, "uavs must be a list of at least one name, got None"),
            ({"action": "launch", "uavs": []}, "uavs must be a list of at least one name"),
            ({"action": "launch", "uavs": ["uav3"]}, "'uav3' is not in the fleet file"),
            ({"action": "launch", "uavs": [{}]}, "{} is not in the fleet file"),
            ({"action": "replan", "id": -1}, "id must be a whole number from 0, got -1"),
            ({"action": "replan", "id": True}, "id must be"),
            ({"action": "replan", "type": "order"}, "type must be 'request', got 'order'"),
            (device(x="12"), "device x must be a number, got '12'"),
            (device(x=True), "device x must be a number, got True"),
            (device(x=None), "device x must be a number, got None"),
            (device(y=10**400), "device y must be finite, got a huge number"),
            (device(y=1e9), "position.y must be from -100000 to 100000 m"),
            (device(demand=0), "rate_demand must be finite and > 0, got 0.0"),
            (device(weight=-1), "weight must be finite and > 0"),
            (device(id=""), "device id must be a text of 1 to 64 characters, got ''"),
            (device(id="x" * 65), "device id must be a text of 1 to 64 characters"),
            (device(id="a\nb"), "device id must be printable"),
            (device(colour="red"), "device: the unknown key 'colour'"),
            ({"action": "put_device", "device": []}, "device must be an object"),
            ({"action": "remove_device"}, "device id must be a text"),
        ],
    )
    def test_what_is_refused_says_which_field_and_value(self, fields, says) -> None:
        with pytest.raises(RequestError, match=says):
            read(**fields)

    @pytest.mark.parametrize("fields", [device(), {"action": "remove_device", "device": "a"}])
    def test_devices_are_only_touched_in_exercise_mode(self, fields) -> None:
        with pytest.raises(RequestError, match="exercise:=true"):
            read(exercise=False, **fields)

    @pytest.mark.parametrize(
        "text", ["", "nonsense", "[1]", "null", '{"x": NaN}', '{"x": Infinity}', "[" * 50_000, "1" * 9000, '"\ud800"']
    )
    def test_what_is_no_object_is_refused(self, text) -> None:
        with pytest.raises(RequestError):
            read_object(text)

    @settings(max_examples=200, deadline=None)
    @given(
        st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=80),
            lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
            max_leaves=12,
        ),
        st.sampled_from(["action", "uavs", "device", "id", "type"]),
    )
    def test_nonsense_of_any_shape_is_one_short_line_or_a_request(self, value, key) -> None:
        data = {"type": "request", "id": 1, "action": "put_device", "uavs": ["uav1"], **device(), key: value}
        try:
            read_request(read_object(json.dumps(data)), UAVS, True)
        except RequestError as error:
            assert "\n" not in str(error) and len(str(error)) < 300

    def test_the_first_message_is_who_it_is(self) -> None:
        assert read_hello('{"type": "hello", "token": "t"}').token == "t"
        with pytest.raises(RequestError, match="must have type 'hello', got 'request'"):
            read_hello('{"type": "request"}')


class TestAccess:
    def test_other_machines_need_a_token(self) -> None:
        for host in ("127.0.0.1", "::1", "localhost"):
            assert Access(host, None).token_is_right(None)
        for host in ("0.0.0.0", "::", "192.168.1.5"):
            with pytest.raises(AccessError, match="can be reached from other machines: set token_file"):
                Access(host, None)
            assert not Access(host, TOKEN).token_is_right(None)
        with pytest.raises(AccessError, match=r"host must be an IP address or localhost, got 'fleet\.example'"):
            Access("fleet.example", None)

    @pytest.mark.parametrize("wrong", [None, "", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), 7, ["x"], "\ud800", "ü"])
    def test_only_the_token_is_the_token(self, wrong) -> None:
        access = Access("0.0.0.0", TOKEN)
        assert access.token_is_right(TOKEN)
        assert not access.token_is_right(wrong)

    @pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "[::1]:8080", "192.168.1.5", "LOCALHOST"])
    def test_own_hosts(self, host) -> None:
        assert Access("127.0.0.1", None).host_problem(host) is None

    @pytest.mark.parametrize("host", [None, "", "attacker.example:8080", "127.0.0.1.attacker.example", "[::1", "a@b"])
    def test_hosts_of_a_rebound_name(self, host) -> None:
        assert Access("127.0.0.1", None).host_problem(host)

    @pytest.mark.parametrize(
        ("origin", "fine"),
        [
            ("http://127.0.0.1:8080", True),
            ("https://127.0.0.1:8080", True),
            ("http://127.0.0.1:9090", False),
            ("http://attacker.example", False),
            ("http://127.0.0.1:8080.attacker.example", False),
            ("http://127.0.0.1:8080@attacker.example", False),
            ("file://127.0.0.1:8080", False),
            ("null", False),
            ("http://[", False),
            (None, False),
        ],
    )
    def test_a_page_from_elsewhere_may_not_connect(self, origin, fine) -> None:
        assert (Access("127.0.0.1", None).origin_problem(origin, "127.0.0.1:8080") is None) is fine


class TestTokenFile:
    def write(self, folder: Path, text: bytes, mode: int = 0o600) -> Path:
        path = folder / "token"
        path.write_bytes(text)
        path.chmod(mode)
        return path

    def test_a_newline_at_its_end_is_no_part_of_it(self, tmp_path: Path) -> None:
        assert load_token(self.write(tmp_path, f"{TOKEN}\r\n".encode())) == TOKEN

    @pytest.mark.parametrize("mode", [0o640, 0o604, 0o777])
    def test_nobody_else_may_read_it(self, tmp_path: Path, mode: int) -> None:
        with pytest.raises(AccessError, match="lets others than its owner at it; chmod 600 it"):
            load_token(self.write(tmp_path, TOKEN.encode(), mode))

    @pytest.mark.parametrize(
        ("text", "says"),
        [
            (b"", "at least 16 characters, got 0"),
            (b"short\n", "at least 16 characters, got 5"),
            (b"\xff" * 20, "must be UTF-8 text"),
            (b"x" * 5000, "at least 16 characters"),
        ],
    )
    def test_a_token_that_is_none(self, tmp_path: Path, text: bytes, says: str) -> None:
        with pytest.raises(AccessError, match=says) as caught:
            load_token(self.write(tmp_path, text))
        assert str(tmp_path) in str(caught.value)

    def test_no_file(self, tmp_path: Path) -> None:
        with pytest.raises(AccessError, match="cannot be read: No such file"):
            load_token(tmp_path / "none")
