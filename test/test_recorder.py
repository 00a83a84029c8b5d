"""The recorder: what a real graph says, read back by the public MCAP libraries; disks that are full, slow or killed."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, PoseStamped
from graph import Graph, NodeProcess
from jpap_msgs.msg import Cell, Deployment, Device, DeviceUpdate, UnservedDevice, VehicleState
from mcap.reader import make_reader
from mcap_files import Recorded, of_topic, torn, whole
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from small_disk import fill, small_disk
from std_msgs.msg import String

from jpap_ros.nodes.qos import DEVICES, LATCHED, SENSOR_DATA
from jpap_ros.nodes.recorder_definitions import full_definition
from jpap_ros.nodes.recorder_file import Channel, Entry
from jpap_ros.nodes.recorder_writer import RecordingWriter, WriterSettings

FLEET = {
    "version": 1,
    "origin": {"latitude": -37.8136, "longitude": 144.9631},
    "uavs": [{"name": f"uav{i}", "sysid": i, "url": f"udpin:127.0.0.1:{14550 + i}"} for i in (1, 2)],
}
TEXTS = Channel("/texts", "std_msgs/msg/String", "string data", "", "")


@pytest.fixture
def fleet_file(tmp_path: Path) -> Path:
    path = tmp_path / "fleet.yaml"
    path.write_text(yaml.safe_dump(FLEET))
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "recordings"


def recordings(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"))


def report(*names: str) -> DeviceUpdate:
    update = DeviceUpdate(devices=[Device(id=n, position=Point(x=1.0, y=-2.0), rate_demand=16.0) for n in names])
    update.header.frame_id = "map"
    return update


def deployment() -> Deployment:
    cells = [Cell(uav="uav1", device_ids=["a", "b"], power_w=[4.0, 6.0], rate=[16.0, 17.5], uav_rate=33.5)]
    return Deployment(
        plan_id=7, reason="2 devices joined", cells=cells, unserved=[UnservedDevice(id="c", reason="far")]
    )


def recording_status(diagnostics: list[DiagnosticArray]) -> DiagnosticStatus | None:
    """The newest word of the recorder about itself."""
    statuses = [s for message in diagnostics for s in message.status if s.name == "/recorder: recording"]
    return statuses[-1] if statuses else None


def test_what_was_said_is_recorded_as_it_was_said(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, folder: Path
) -> None:
    """Oracle: the messages that the test published; `mcap` reads the file, rclpy and `mcap_ros2` its messages."""
    devices = graph.node.create_publisher(DeviceUpdate, "devices", DEVICES)
    early = [report("a"), report("b", "c")]
    for message in early:
        devices.publish(message)
    plans = graph.node.create_publisher(Deployment, "deployment", LATCHED)
    plans.publish(deployment())
    graph.node.declare_parameter("scheme", "optimal")

    recorder = start_node("recorder", {"fleet_file": str(fleet_file), "folder": str(folder)})
    pose_out = graph.publisher(PoseStamped, "uav2/pose", SENSOR_DATA)
    other = graph.node.create_publisher(String, "camera/text", 10)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    graph.wait(lambda: devices.get_subscription_count() and plans.get_subscription_count(), "the recorder listens")
    late, pose = report("d"), PoseStamped()
    devices.publish(late)
    pose.pose.position.x = 0.1
    pose_out.publish(pose)
    other.publish(String(data="not of this fleet"))

    def recorded_all() -> bool:
        status = recording_status(diagnostics)
        return status is not None and status.level == DiagnosticStatus.OK and asked()

    def asked() -> bool:
        (path,) = recordings(folder)
        return b"parameters of /tester" in path.read_bytes() and {"/devices", "/deployment", "/uav2/pose"} <= {
            m.topic for m in torn(path)
        }

    graph.wait(recorded_all, "everything is in the file")
    assert recorder.stop() == 0, recorder.output

    (path,) = recordings(folder)
    messages = whole(path)
    by_topic: dict[str, list[Recorded]] = {}
    for message in messages:
        by_topic.setdefault(message.topic, []).append(message)
    # Not byte by byte: what CDR pads with is not defined.
    assert [deserialize_message(m.data, DeviceUpdate) for m in by_topic["/devices"]] == [*early, late]
    assert [deserialize_message(m.data, Deployment) for m in by_topic["/deployment"]] == [deployment()]
    assert [deserialize_message(m.data, PoseStamped) for m in by_topic["/uav2/pose"]] == [pose]
    assert {"/diagnostics", "/rosout"} <= set(by_topic) and "/camera/text" not in by_topic
    assert all(0 <= m.log_ns - m.publish_ns < 60e9 for m in by_topic["/uav2/pose"])

    plan = by_topic["/deployment"][0].decoded
    assert by_topic["/deployment"][0].type_name == "jpap_msgs/msg/Deployment"
    assert (plan.plan_id, plan.reason, plan.cells[0].rate[1], plan.unserved[0].id) == (7, "2 devices joined", 17.5, "c")
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        metadata = {c.topic: c.metadata for c in summary.channels.values()}
        (qos,) = yaml.safe_load(metadata["/deployment"]["offered_qos_profiles"])
        assert (qos["reliability"], qos["durability"]) == ("reliable", "transient_local")
        (qos,) = yaml.safe_load(metadata["/uav2/pose"]["offered_qos_profiles"])
        assert (qos["reliability"], qos["durability"]) == ("best_effort", "volatile")
        assert metadata["/deployment"]["topic_type_hash"].startswith("RIHS01_")
        (attachment,) = reader.iter_attachments()
        assert (attachment.name, attachment.data) == ("fleet.yaml", fleet_file.read_bytes())
        (parameters,) = reader.iter_metadata()
        assert parameters.name == "parameters of /tester"
        assert json.loads(parameters.metadata["scheme"]) == "optimal"


def test_a_full_disk_stops_the_recording_once_and_it_goes_on_when_there_is_room(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, tmp_path: Path
) -> None:
    """A real file system that is really full; the test's own list of what it published is the oracle."""
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    with small_disk(tmp_path / "disk", 8192) as disk:
        parameters = {"fleet_file": str(fleet_file), "folder": str(disk), "topics": ["texts"], "min_free_mb": 0}
        recorder = start_node("recorder", {**parameters, "flush_s": 0.1, "retry_s": 0.2, "chunk_kb": 16})
        texts = graph.publisher(String, "texts", QoSProfile(depth=1000))
        said = 0

        def say_until(condition: Callable[[DiagnosticStatus], bool], what: str) -> None:
            def tick() -> bool:
                nonlocal said
                texts.publish(String(data=str(said)))
                said += 1
                status = recording_status(diagnostics)
                return status is not None and condition(status)

            graph.wait(tick, what)

        say_until(lambda s: figure(s, "messages") > 20, "something is recorded")
        ballast = fill(disk)
        say_until(lambda s: s.level == DiagnosticStatus.ERROR, "the recorder reports the full disk")
        told = recording_status(diagnostics)
        assert told is not None
        assert "No space left on device" in told.message and "make room" in told.message
        say_until(lambda s: figure(s, "messages lost") > 50, "messages are lost and counted")
        ballast.unlink()
        before = figure(recording_status(diagnostics), "messages")
        say_until(lambda s: s.level == DiagnosticStatus.OK and figure(s, "messages") > before + 20, "it goes on")
        assert recorder.stop() == 0
        first, second = recordings(disk)
        numbers = [int(text.data) for text in of_topic(torn(first), "/texts")]
        later = [int(text.data) for text in of_topic(whole(second), "/texts")]
    assert recorder.output.count("recording stopped") == 1
    assert recorder.output.count("recording goes on") == 1
    # Contiguous before and after: nothing was garbled, and only what the full disk cost is missing.
    assert len(numbers) > 20 and numbers == list(range(numbers[0], numbers[-1] + 1))
    assert len(later) > 20 and later == list(range(later[0], later[-1] + 1))
    assert later[0] > numbers[-1] + 50


def figure(status: DiagnosticStatus | None, key: str) -> int:
    assert status is not None
    return int({value.key: value.value for value in status.values}[key])


def test_a_killed_recorder_leaves_what_was_heard(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, folder: Path
) -> None:
    recorder = start_node("recorder", {"fleet_file": str(fleet_file), "folder": str(folder), "flush_s": 0.2})
    states = graph.publisher(VehicleState, "uav1/state", LATCHED)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    states.publish(VehicleState(uav="uav1", mode="GUIDED", battery_remaining=0.5))

    def recorded() -> bool:
        status = recording_status(diagnostics)
        return status is not None and bool(of_topic(torn(recordings(folder)[0]), "/uav1/state"))

    graph.wait(recorded, "the state is in the file")
    recorder.stop(signal.SIGKILL)
    (state,) = of_topic(torn(recordings(folder)[0]), "/uav1/state")
    assert (state.uav, state.mode, state.battery_remaining) == ("uav1", "GUIDED", 0.5)


@pytest.mark.parametrize(
    ("parameter", "value", "said"),
    [
        ("compression", "rar", "parameter compression must be one of"),
        ("topics", ["devices", ""], "parameter topics"),
        ("folder", "/dev/null/recordings", "parameter folder: cannot record"),
        ("min_free_mb", 1_000_000, "parameter folder: cannot record"),
    ],
)
def test_bad_parameters_are_refused_in_one_line(
    start_node: Callable[..., NodeProcess], folder: Path, parameter: str, value: object, said: str
) -> None:
    recorder = start_node("recorder", {"folder": str(folder), parameter: value})
    assert recorder.wait() == 1
    (line,) = [line for line in recorder.output.splitlines() if "cannot start" in line]
    assert said in line


# The writer alone


def entries(count: int, size: int) -> list[Entry]:
    return [Entry(TEXTS, i, i, serialize_message(String(data=f"{i:06d}".ljust(size)))) for i in range(count)]


def test_a_recording_is_split_without_losing_a_message(folder: Path) -> None:
    settings = WriterSettings(
        folder, "none", flush_s=0.01, max_bytes=20_000, min_free_bytes=0, attachments={"fleet.yaml": b"x"}
    )
    writer = RecordingWriter(settings, lambda line: None, pytest.fail)
    writer.add_metadata("parameters of /planner", {"a": "1"})
    messages = entries(100, 1000)
    for entry in messages:
        writer.put([entry])
        while writer.report.pending_bytes:
            time.sleep(0.001)
    writer.close()
    paths = recordings(folder)
    assert len(paths) >= 4
    assert [m.data for path in paths for m in whole(path)] == [entry.data for entry in messages]
    assert writer.report.messages == 100 and writer.report.bytes == sum(path.stat().st_size for path in paths)
    for path in paths:
        with path.open("rb") as file:
            reader = make_reader(file)
            assert [a.data for a in reader.iter_attachments()] == [b"x"]
            assert [m.metadata for m in reader.iter_metadata()] == [{"a": "1"}]


def test_a_queue_that_is_full_drops_and_counts(folder: Path) -> None:
    messages = entries(100, 1000)
    size = len(messages[0].data)
    writer = RecordingWriter(
        WriterSettings(folder, max_pending_bytes=10 * size, min_free_bytes=0), lambda line: None, pytest.fail
    )
    writer.put(messages)
    assert writer.report.dropped == 90
    writer.close()
    (path,) = recordings(folder)
    assert [m.data for m in whole(path)] == [entry.data for entry in messages[:10]]


def test_recording_stops_before_the_disk_is_full_and_ends_its_file(tmp_path: Path) -> None:
    told: list[str] = []
    with small_disk(tmp_path / "disk", 2048) as disk:
        settings = WriterSettings(disk, "none", flush_s=0.01, min_free_bytes=1 << 20, retry_s=3600.0)
        writer = RecordingWriter(settings, lambda line: None, told.append)
        (disk / "other").write_bytes(bytes(1_200_000))
        while not writer.report.problem:
            writer.put(entries(1, 100))
        assert writer.report.path is None and "must stay free" in told[0]
        (path,) = recordings(disk)
        kept = whole(path)
        writer.close()
    assert len(told) == 1 and len(kept) == writer.report.messages > 0


def test_definitions_hold_every_type_within() -> None:
    text = full_definition("jpap_msgs/msg/Deployment")
    names = [line[5:] for line in text.splitlines() if line.startswith("MSG: ")]
    # Worked out by hand from the .msg files.
    assert sorted(names) == [
        "builtin_interfaces/Duration",
        "builtin_interfaces/Time",
        "geometry_msgs/Point",
        "geometry_msgs/Pose",
        "geometry_msgs/Quaternion",
        "jpap_msgs/Cell",
        "jpap_msgs/UnservedDevice",
        "std_msgs/Header",
    ]
    with pytest.raises(LookupError, match="nowhere_msgs"):
        full_definition("nowhere_msgs/msg/Nothing")
