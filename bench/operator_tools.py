"""What the operator's tools cost beside a large fleet: the dashboard with no, one and five pages open; the recorder.

A synthetic fleet publishes what planner and bridge would: poses at a rate, states, diagnostics and goals of every
aircraft, a plan that serves 1,000 devices, and a new plan every ten seconds. CPU is that of the whole process of the
tool (user and system, from /proc), in shares of one core; memory is its resident set. Frames are those that headless
Chromium draws a second, without a GPU.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import os
import random
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from jpap_msgs.msg import Cell, Deployment, Device, DeviceUpdate, UnservedDevice, VehicleState
from mcap.reader import make_reader
from playwright.sync_api import sync_playwright
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Header

from jpap_ros.demo.own_graph import own_graph
from jpap_ros.nodes.qos import DEVICES, LATCHED, SENSOR_DATA

CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
AREA_M = 4000.0
#: A place in the middle of Melbourne, as in the demo.
ORIGIN = {"latitude": -37.8142, "longitude": 144.9632, "altitude_amsl_m": 20}
PATIENCE_S = 60.0


class SyntheticFleet(Node):
    """Aircraft that circle over their cells, and the plan that they fly."""

    def __init__(self, aircraft: int, devices: int, pose_hz: float) -> None:
        super().__init__("synthetic_fleet")
        draw = random.Random(1)
        self.names = [f"uav{i + 1}" for i in range(aircraft)]
        self._centres = [self._place(i, aircraft) for i in range(aircraft)]
        self._devices = [self._device(draw, i) for i in range(devices)]
        self._poses = {n: self.create_publisher(PoseStamped, f"{n}/pose", SENSOR_DATA) for n in self.names}
        self._states = {n: self.create_publisher(VehicleState, f"{n}/state", LATCHED) for n in self.names}
        self._goals = {n: self.create_publisher(PoseStamped, f"{n}/goal_pose", LATCHED) for n in self.names}
        self._deployment = self.create_publisher(Deployment, "deployment", LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        update = DeviceUpdate(header=self._header(), snapshot=True)
        update.devices = [device for device, _ in self._devices]
        self._reports = self.create_publisher(DeviceUpdate, "devices", DEVICES)
        self._reports.publish(update)
        self._plan_id = 0
        self._publish_plan()
        # Spread over the period, as telemetry of many links is.
        self._turn = 0
        #: Poses published so far: on a busy machine fewer than asked for.
        self.poses_sent = 0
        self.create_timer(1.0 / (pose_hz * 10.0), self._publish_tenth)
        self.create_timer(1.0, self._publish_second)
        self.create_timer(10.0, self._publish_plan)

    def _place(self, i: int, aircraft: int) -> tuple[float, float]:
        side = math.ceil(math.sqrt(aircraft))
        pitch = AREA_M / side
        return pitch * (i % side + 0.5) - AREA_M / 2, pitch * (i // side + 0.5) - AREA_M / 2

    def _device(self, draw: random.Random, i: int) -> tuple[Device, int]:
        cell = i % len(self.names)
        east, north = self._centres[cell]
        place = Point(x=east + draw.uniform(-180, 180), y=north + draw.uniform(-180, 180))
        return Device(id=f"d{i}", position=place, rate_demand=draw.uniform(10, 17), weight=1.0), cell

    def _header(self) -> Header:
        return Header(stamp=self.get_clock().now().to_msg(), frame_id="map")

    def _at(self, i: int) -> tuple[float, float, float]:
        """East, north [m] and direction [rad] of an aircraft on its circle."""
        angle = 0.1 * time.monotonic() + i
        east, north = self._centres[i]
        return east + 80.0 * math.cos(angle), north + 80.0 * math.sin(angle), angle + math.pi / 2

    def _publish_tenth(self) -> None:
        header = self._header()
        self._turn = (self._turn + 1) % 10
        for i in range(self._turn, len(self.names), 10):
            east, north, yaw = self._at(i)
            turn = Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
            pose = Pose(position=Point(x=east, y=north, z=50.0), orientation=turn)
            self.poses_sent += 1
            self._poses[self.names[i]].publish(PoseStamped(header=header, pose=pose))

    def _publish_second(self) -> None:
        header = self._header()
        statuses = []
        for i, name in enumerate(self.names):
            east, north, _ = self._at(i)
            self._states[name].publish(
                VehicleState(
                    header=header,
                    uav=name,
                    sysid=i % 254 + 1,
                    link=VehicleState.LINK_CONNECTED,
                    autopilot="ardupilot",
                    mode="GUIDED",
                    armed=True,
                    landed_state=VehicleState.LANDED_IN_AIR,
                    battery_remaining=0.5 + 0.4 * math.sin(0.01 * time.monotonic() + i),
                    position_valid=True,
                    position=Point(x=east, y=north, z=50.0),
                    goal_state=VehicleState.GOAL_REACHED if i % 4 else VehicleState.GOAL_EN_ROUTE,
                    goal_plan_id=self._plan_id,
                    goal_distance_m=80.0,
                )
            )
            values = {"heartbeat age [s]": "0.4", "loss on udpin:127.0.0.1:1 [%]": "1.5", "plan id": str(self._plan_id)}
            statuses.append(self._status(name, values))
        statuses.append(self._status("deployment", {"plan id": str(self._plan_id)}))
        self._diagnostics.publish(DiagnosticArray(header=header, status=statuses))

    def _status(self, part: str, values: dict[str, str]) -> DiagnosticStatus:
        return DiagnosticStatus(
            name=f"{self.get_fully_qualified_name()}: {part}",
            message="fine",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )

    def _publish_plan(self) -> None:
        self._plan_id += 1
        header = self._header()
        cells = []
        for i, name in enumerate(self.names):
            east, north = self._centres[i]
            goal = Pose(position=Point(x=east, y=north, z=50.0), orientation=Quaternion(w=1.0))
            self._goals[name].publish(PoseStamped(header=header, pose=goal))
            own = [device for device, cell in self._devices if cell == i and device.id != "d7"]
            cells.append(
                Cell(
                    uav=name,
                    goal_pose=goal,
                    device_ids=[device.id for device in own],
                    power_w=[1.0] * len(own),
                    rate=[device.rate_demand + 0.1 * (self._plan_id % 7) for device in own],
                    uav_rate=sum(device.rate_demand for device in own),
                    coverage_radius_m=math.nan,
                )
            )
        self._deployment.publish(
            Deployment(
                header=header,
                plan_id=self._plan_id,
                reason="1 device moved",
                scheme="optimal",
                cells=cells,
                unserved=[UnservedDevice(id="d7", reason="demands 19 bit/s, the most that can be met is 17.3 bit/s")],
                uavs_needed=len(cells),
                min_uavs_bound=len(cells) - 1,
                average_uav_rate=140.0,
                average_uav_rate_bound=150.0,
            )
        )


class Usage:
    """CPU time and memory of a process, since the last look."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._since = time.monotonic(), self._cpu_s()

    def look(self) -> tuple[float, float]:
        """Share of one core [%] since the last look, and resident memory [MB] now."""
        (then, cpu), self._since = self._since, (time.monotonic(), self._cpu_s())
        pages = int(Path(f"/proc/{self._pid}/statm").read_text().split()[1])
        share = 100.0 * (self._since[1] - cpu) / (self._since[0] - then)
        return share, pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    def _cpu_s(self) -> float:
        fields = Path(f"/proc/{self._pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Readers:
    """Pages without a browser: they read everything, in a process of their own."""

    def __init__(self, port: int, count: int) -> None:
        command = [sys.executable, __file__, "--read", str(port), str(count)]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None and self._process.stdout.readline() == "reading\n"

    def close(self) -> tuple[float, float]:
        """Stop; return messages and bytes a second that each got."""
        self._process.terminate()
        out, _ = self._process.communicate()
        messages, octets = json.loads(out)
        return messages, octets


async def read(port: int, count: int) -> None:
    """Child: read until terminated."""
    got = [0, 0]
    ready = asyncio.Semaphore(0)

    async def page(session: aiohttp.ClientSession) -> None:
        origin = f"http://127.0.0.1:{port}"
        async with session.ws_connect(f"{origin}/ws", headers={"Origin": origin}, max_msg_size=0) as socket_:
            await socket_.send_json({"type": "hello"})
            await socket_.receive()
            ready.release()
            async for message in socket_:
                got[0] += 1
                got[1] += len(message.data)

    stop = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(15, stop.set)
    async with aiohttp.ClientSession() as session:
        pages = [asyncio.create_task(page(session)) for _ in range(count)]
        for _ in range(count):
            await ready.acquire()
        print("reading", flush=True)
        began = time.monotonic()
        await stop.wait()
        span = (time.monotonic() - began) * count
        for task in pages:
            task.cancel()
    print(json.dumps([got[0] / span, got[1] / span]))


@contextlib.contextmanager
def tool(name: str, folder: Path, parameters: dict[str, object]) -> Iterator[tuple[int, Path]]:
    """Run one executable; gives its process id and log."""
    program = Path(get_package_prefix("jpap_ros")) / "lib" / "jpap_ros" / name
    arguments = [item for key, value in parameters.items() for item in ("-p", f"{key}:={json.dumps(value)}")]
    log = folder / f"{name}.log"
    with log.open("w") as sink:
        process = subprocess.Popen([str(program), "--ros-args", *arguments], stdout=sink, stderr=subprocess.STDOUT)
    try:
        yield process.pid, log
    finally:
        process.send_signal(2)
        process.wait(PATIENCE_S)


def measure_dashboard(folder: Path, fleet_file: Path, args: argparse.Namespace, fleet: SyntheticFleet) -> None:
    """Print the cost of the dashboard, then the frames that a browser draws."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tool("dashboard", folder, {"fleet_file": str(fleet_file), "port": port}) as (pid, log):
        deadline = time.monotonic() + PATIENCE_S
        while "open http" not in log.read_text():
            assert time.monotonic() < deadline, log.read_text()
            time.sleep(0.1)
        # Until it has found every topic.
        time.sleep(15.0)
        each_page = f"{'messages/s':>12}{'kB/s':>8}   (each page)"
        print(f"{'dashboard':24}{'CPU [%]':>10}{'memory [MB]':>14}{'poses/s':>10}{each_page}")
        for pages in (0, 1, 5):
            readers = Readers(port, pages) if pages else None
            usage, sent = Usage(pid), fleet.poses_sent
            time.sleep(args.seconds)
            share, memory = usage.look()
            poses = (fleet.poses_sent - sent) / args.seconds
            messages, octets = readers.close() if readers else (0.0, 0.0)
            print(
                f"{pages} pages{'':17}{share:>10.1f}{memory:>14.1f}{poses:>10.0f}{messages:>12.1f}{octets / 1e3:>8.1f}"
            )
        measure_frames(port, args)


def measure_frames(port: int, args: argparse.Namespace) -> None:
    """Print how smoothly headless Chromium draws, at rest and while the map is dragged."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(f"http://127.0.0.1:{port}/")
        page.locator("#aircraft tr").first.wait_for()
        page.wait_for_timeout(3000)
        count = """(seconds) => new Promise((resolve) => {
            const times = [performance.now()];
            const frame = (now) => {
                times.push(now);
                if (now - times[0] < 1000 * seconds) requestAnimationFrame(frame);
                else {
                    const gaps = times.slice(1).map((t, i) => t - times[i]).sort((a, b) => a - b);
                    resolve([1000 * gaps.length / (times.at(-1) - times[0]), gaps[Math.floor(0.95 * gaps.length)]]);
                }
            };
            requestAnimationFrame(frame);
        })"""
        rate, slow_ms = page.evaluate(count, args.seconds)
        print(f"frames/s, {len_text(args)}: {rate:.1f}, 95 % of frames within {slow_ms:.0f} ms")
        drag = """() => { let i = 0; setInterval(() => {
            const map = document.getElementById("map");
            map.dispatchEvent(new WheelEvent("wheel", { deltaY: i++ % 20 < 10 ? 40 : -40, clientX: 400, clientY: 400,
                bubbles: true }));
        }, 50); }"""
        page.evaluate(drag)
        rate, slow_ms = page.evaluate(count, args.seconds)
        print(f"frames/s while it is zoomed all the time: {rate:.1f}, 95 % of frames within {slow_ms:.0f} ms")
        if args.picture:
            page.reload()
            page.wait_for_timeout(4000)
            page.screenshot(path=args.picture)
        browser.close()


def measure_recorder(folder: Path, fleet_file: Path, args: argparse.Namespace) -> None:
    """Print the cost of the recorder, and what it wrote."""
    recordings = folder / "recordings"
    with tool("recorder", folder, {"fleet_file": str(fleet_file), "folder": str(recordings)}) as (pid, log):
        deadline = time.monotonic() + PATIENCE_S
        while "recording to" not in log.read_text():
            assert time.monotonic() < deadline, log.read_text()
            time.sleep(0.1)
        (path,) = recordings.iterdir()
        # Until it has found every topic.
        time.sleep(15.0)
        usage, size = Usage(pid), path.stat().st_size
        time.sleep(args.seconds)
        share, memory = usage.look()
        rate = (path.stat().st_size - size) / args.seconds
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None and summary.statistics is not None
        statistics = summary.statistics
    span = 1e-9 * (statistics.message_end_time - statistics.message_start_time)
    print(f"{'recorder':24}{'CPU [%]':>10}{'memory [MB]':>14}{'messages/s':>12}{'kB/s':>8}   (on disk)")
    print(f"{'':24}{share:>10.1f}{memory:>14.1f}{statistics.message_count / span:>12.1f}{rate / 1e3:>8.1f}")
    print(
        f"{statistics.channel_count} topics; {'slow disk' if 'too slow' in log.read_text() else 'no message dropped'}"
    )


def len_text(args: argparse.Namespace) -> str:
    return f"{args.aircraft} aircraft and {args.devices} devices"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--aircraft", type=int, default=100)
    parser.add_argument("--devices", type=int, default=1000)
    parser.add_argument("--pose-hz", type=float, default=5.0)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each measurement")
    parser.add_argument("--only", choices=("dashboard", "recorder"), help="measure this tool alone")
    parser.add_argument("--picture", help="keep a picture of the page here")
    parser.add_argument("--read", nargs=2, type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.read:
        asyncio.run(read(*args.read))
        return
    print(f"load average {os.getloadavg()[0]:.1f}; {len_text(args)}, poses at {args.pose_hz:g} Hz")
    with own_graph(), tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        fleet_file = folder / "fleet.yaml"
        uavs = [
            {"name": f"uav{i + 1}", "sysid": i % 254 + 1, "url": f"udpin:127.0.0.1:{20_000 + i}"}
            for i in range(args.aircraft)
        ]
        fleet_file.write_text(yaml.safe_dump({"version": 1, "origin": ORIGIN, "uavs": uavs}))
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        fleet = SyntheticFleet(args.aircraft, args.devices, args.pose_hz)
        executor = SingleThreadedExecutor()
        executor.add_node(fleet)
        threading.Thread(target=executor.spin, daemon=True).start()
        if args.only != "recorder":
            measure_dashboard(folder, fleet_file, args, fleet)
        if args.only != "dashboard":
            measure_recorder(folder, fleet_file, args)
        executor.shutdown()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
