"""Signing. Oracle: signatures computed here with hashlib from the published formula (mavlink_frames)."""

from __future__ import annotations

import hashlib
import logging
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from mavlink_frames import frame_v1, frame_v2, heartbeat, signature_block
from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.links import Link, LinkHub, LinkOptions, Packet
from jpap_ros.mavlink.signing import Signer, SigningError, SigningKey, Verdict

KEY = bytes(range(32))
OTHER_KEY = bytes(32)
BEAT = dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
# 2026-11-22 00:00:00 GMT, and the same in units of 10 us since 2015-01-01 00:00:00 GMT: 4343 days.
START_UNIX_S = 1_795_305_600
START = 4343 * 86_400 * 100_000
MINUTE = 6_000_000


def key_file(folder: Path, text: bytes = KEY.hex().encode(), mode: int = 0o600) -> Path:
    path = folder / "fleet.key"
    path.write_bytes(text)
    path.chmod(mode)
    return path


def signer(folder: Path, key: bytes = KEY, unix_s: float = START_UNIX_S) -> Signer:
    return Signer(SigningKey(key), folder / "state", clock=lambda: unix_s)


class TestKeyFile:
    def test_hexadecimal_digits(self, tmp_path: Path) -> None:
        assert SigningKey.load(key_file(tmp_path, KEY.hex().upper().encode() + b"\n")).secret == KEY

    @pytest.mark.parametrize("passphrase", [b"correct horse battery staple", b"z" * 64, "Flügel".encode()])
    def test_a_passphrase_is_hashed(self, tmp_path: Path, passphrase: bytes) -> None:
        key = SigningKey.load(key_file(tmp_path, passphrase + b"\r\n"))
        assert key.secret == hashlib.sha256(passphrase).digest()

    @pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644, 0o610])
    def test_others_must_not_get_at_it(self, tmp_path: Path, mode: int) -> None:
        with pytest.raises(SigningError, match=rf"fleet\.key: its mode {mode:04o} .*chmod 600"):
            SigningKey.load(key_file(tmp_path, mode=mode))

    @pytest.mark.parametrize("text", [b"", b"\n", b"x" * 5000])
    def test_an_unusable_file(self, tmp_path: Path, text: bytes) -> None:
        with pytest.raises(SigningError, match=r"fleet\.key: must hold"):
            SigningKey.load(key_file(tmp_path, text))

    def test_a_missing_file(self, tmp_path: Path) -> None:
        with pytest.raises(SigningError, match=r"nowhere\.key: cannot be read: No such file"):
            SigningKey.load(tmp_path / "nowhere.key")

    def test_the_key_shows_nowhere(self, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
        caplog.set_level(logging.DEBUG)
        secret = hashlib.sha256(b"secret words").digest()
        options = LinkOptions(signer=Signer.load(key_file(tmp_path, b"secret words")))
        with LinkHub(245) as hub, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
            vehicle.bind(("127.0.0.1", 0))
            link = hub.open(LinkUrl("udpout", "127.0.0.1", vehicle.getsockname()[1]), options)
            hub.send(link, BEAT)
            shown = " ".join(
                [repr(options), str(options), repr(link), repr(hub), repr(options.signer.key), caplog.text]
            )
        shown += (tmp_path / "fleet.key.timestamp").read_text()
        for form in ("secret words", secret.hex(), repr(secret), repr(list(secret))):
            assert form not in shown


class TestTimestamps:
    def test_they_count_from_2015(self, tmp_path: Path) -> None:
        assert signer(tmp_path).next_timestamp() == START + 1

    def test_they_grow_faster_than_a_stopped_clock(self, tmp_path: Path) -> None:
        one = signer(tmp_path)
        stamps = [one.next_timestamp() for _ in range(1000)]
        assert stamps == list(range(START + 1, START + 1001))

    @pytest.mark.parametrize("clock_goes_to", [START_UNIX_S + 0.5, START_UNIX_S, START_UNIX_S - 86_400, 0.0])
    @pytest.mark.parametrize("orderly", [True, False])
    def test_they_never_go_back_over_a_restart(self, tmp_path: Path, clock_goes_to: float, orderly: bool) -> None:
        # A board without a battery-backed clock starts in 1970; a crash leaves only what was stored before.
        first = signer(tmp_path)
        last = max(first.next_timestamp() for _ in range(30_000))
        if orderly:
            first.close()
        second = signer(tmp_path, unix_s=clock_goes_to)
        assert second.next_timestamp() > last

    def test_they_outlive_a_crash_after_a_long_run(self, tmp_path: Path) -> None:
        now = [START_UNIX_S]
        first = Signer(SigningKey(KEY), tmp_path / "state", clock=lambda: now[0])
        for _ in range(100):
            now[0] += 0.7
            last = first.next_timestamp()
        assert last == START + 7_000_000
        assert signer(tmp_path, unix_s=0.0).next_timestamp() > last

    def test_restarts_do_not_run_away_from_the_time(self, tmp_path: Path) -> None:
        # A ground station whose clock is right is refused as a new stream when it is a minute behind.
        for _ in range(20):
            one = signer(tmp_path)
            one.next_timestamp()
            one.close()
        assert one.next_timestamp() - START < MINUTE / 100
        for _ in range(5):
            one = signer(tmp_path)
            one.next_timestamp()
        assert one.next_timestamp() - START < MINUTE

    def test_they_follow_a_peer_that_is_ahead(self, tmp_path: Path) -> None:
        one = signer(tmp_path)
        assert one.check(heartbeat(key=KEY, timestamp=START + 10 * MINUTE)) is Verdict.GOOD
        assert one.next_timestamp() == START + 10 * MINUTE + 1

    @pytest.mark.parametrize("text", ["", "soon", "-5", "9" * 40])
    def test_a_damaged_state_file_is_named(self, tmp_path: Path, text: str) -> None:
        (tmp_path / "state").write_text(text)
        with pytest.raises(SigningError, match=r"state file .*state: must hold a timestamp"):
            signer(tmp_path)

    def test_a_folder_that_cannot_be_written_is_named(self, tmp_path: Path) -> None:
        with pytest.raises(SigningError, match="cannot be written"):
            Signer(SigningKey(KEY), tmp_path / "no such folder" / "state")

    def test_no_half_written_state_is_left(self, tmp_path: Path) -> None:
        signer(tmp_path).close()
        assert [path.name for path in tmp_path.iterdir()] == ["state"]


class TestCheck:
    def test_good_frames(self, tmp_path: Path) -> None:
        one = signer(tmp_path)
        for i in range(5):
            assert one.check(heartbeat(sequence=i, key=KEY, timestamp=START + i)) is Verdict.GOOD

    def test_unsigned_frames(self, tmp_path: Path) -> None:
        one = signer(tmp_path)
        assert one.check(heartbeat()) is Verdict.UNSIGNED
        assert one.check(frame_v1(0, 50, bytes(9), 1, 1)) is Verdict.UNSIGNED

    @pytest.mark.parametrize("position", [*range(-13, 0), 4, 5, 6, 10, 15])
    def test_any_change_is_found(self, tmp_path: Path, position: int) -> None:
        frame = bytearray(heartbeat(key=KEY, timestamp=START))
        frame[position] ^= 1
        assert signer(tmp_path).check(frame) is Verdict.FORGED

    def test_another_key(self, tmp_path: Path) -> None:
        assert signer(tmp_path).check(heartbeat(key=OTHER_KEY, timestamp=START)) is Verdict.FORGED

    def test_a_replayed_frame(self, tmp_path: Path) -> None:
        one = signer(tmp_path)
        frames = [heartbeat(sequence=i, key=KEY, timestamp=START + i) for i in range(3)]
        assert [one.check(frame) for frame in frames] == [Verdict.GOOD] * 3
        assert [one.check(frame) for frame in frames] == [Verdict.REPLAYED] * 3

    def test_each_source_and_link_id_has_a_time_of_its_own(self, tmp_path: Path) -> None:
        one = signer(tmp_path)
        for source in [(1, 1, 0), (1, 1, 1), (1, 154, 0), (2, 1, 0)]:
            frame = heartbeat(source[0], source[1], key=KEY, link_id=source[2], timestamp=START)
            assert one.check(frame) is Verdict.GOOD
            assert one.check(frame) is Verdict.REPLAYED

    def test_a_new_stream_may_be_a_minute_behind(self, tmp_path: Path) -> None:
        one = signer(tmp_path)
        assert one.check(heartbeat(1, key=KEY, timestamp=START - MINUTE)) is Verdict.GOOD
        assert one.check(heartbeat(2, key=KEY, timestamp=START - MINUTE - 1)) is Verdict.REPLAYED

    def test_a_forged_timestamp_does_not_silence_the_real_vehicle(self, tmp_path: Path) -> None:
        # What pymavlink's own check does: it takes the forged frame's time over before it looks at the signature.
        one = signer(tmp_path)
        assert one.check(heartbeat(key=KEY, timestamp=START)) is Verdict.GOOD
        assert one.check(heartbeat(key=OTHER_KEY, timestamp=(1 << 48) - 1)) is Verdict.FORGED
        assert one.check(heartbeat(key=KEY, timestamp=START + 1)) is Verdict.GOOD

    def test_frames_that_the_dialect_lacks_are_checked_too(self, tmp_path: Path) -> None:
        one = signer(tmp_path)
        frame = frame_v2(60_000, 1, b"unknown", 1, 1, flags=1)
        assert one.check(frame + signature_block(frame, OTHER_KEY, 0, START)) is Verdict.FORGED
        assert one.check(frame + signature_block(frame, KEY, 0, START)) is Verdict.GOOD


@dataclass
class SignedLink:
    """A hub with one link that has a key, and a plain socket on the other side."""

    hub: LinkHub
    link: Link
    vehicle: socket.socket
    address: tuple[str, int]

    def hear(self, *frames: bytes) -> list[Packet]:
        """Send frames in one datagram, then a good one that marks the end."""
        marker = heartbeat(99, key=KEY, timestamp=START + 1000)
        self.vehicle.sendto(b"".join(frames) + marker, self.address)
        packets: list[Packet] = []
        while not packets or packets[-1].message.get_srcSystem() != 99:
            packets += self.hub.poll(10.0)
        return packets[:-1]


@pytest.fixture
def signed(tmp_path: Path) -> Iterator[SignedLink]:
    with LinkHub(245) as hub, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        vehicle.settimeout(10.0)
        url = LinkUrl("udpout", "127.0.0.1", vehicle.getsockname()[1])
        hub.open(url)
        link = hub.open(url, LinkOptions(signer=signer(tmp_path)))
        yield SignedLink(hub, link, vehicle, link.local_address)


class TestLink:
    def test_what_is_sent_is_signed(self, signed: SignedLink) -> None:
        for sequence in range(3):
            assert signed.hub.send(signed.link, BEAT)
            frame = signed.vehicle.recv(1000)
            unsigned = frame_v2(0, 50, bytes([0, 0, 0, 0, 18, 8, 0, 4, 3]), 245, 191, sequence, flags=1)
            # The second link of the hub has link id 1.
            assert frame == unsigned + signature_block(unsigned, KEY, 1, START + 1 + sequence)

    def test_a_link_without_a_key_stays_unsigned(self, signed: SignedLink) -> None:
        signed.hub.send(signed.link, BEAT)
        signed.hub.send(signed.hub.links[0], BEAT)
        assert [len(signed.vehicle.recv(1000)) for _ in range(2)] == [21 + 13, 21]

    def test_forged_frames_are_counted_and_never_passed_up(self, signed: SignedLink) -> None:
        good = heartbeat(1, key=KEY, timestamp=START)
        unknown = frame_v2(60_000, 1, b"unknown", 1, 1, flags=0)
        packets = signed.hear(
            heartbeat(1),
            heartbeat(1, key=OTHER_KEY, timestamp=START),
            frame_v1(0, 50, bytes(9), 1, 1),
            unknown,
            good,
            good,
        )
        assert [bytes(packet.message.get_msgbuf()) for packet in packets] == [good]
        statistics = signed.link.statistics
        assert statistics.refused == {
            Verdict.GOOD: 0,
            Verdict.UNSIGNED: 3,
            Verdict.FORGED: 1,
            Verdict.REPLAYED: 1,
        }
        assert statistics.received.messages == 2
        assert set(statistics.sources) == {(1, 1), (99, 1)}

    def test_a_radio_may_report_unsigned(self, signed: SignedLink) -> None:
        # RADIO_STATUS: rxerrors, fixed (2 bytes), rssi, remrssi, txbuf, noise, remnoise; CRC_EXTRA 185.
        report = frame_v2(109, 185, bytes([0, 0, 0, 0, 200, 190, 100, 40, 45]), 51, 68)
        (packet,) = signed.hear(report)
        assert packet.message.rssi == 200


def test_the_signer_of_a_key_file_keeps_its_state_beside_it(tmp_path: Path) -> None:
    path = key_file(tmp_path)
    first = Signer.load(path).next_timestamp()
    assert Signer.load(path).next_timestamp() > first
    assert (tmp_path / "fleet.key.timestamp").exists()


def test_a_key_has_32_bytes() -> None:
    with pytest.raises(SigningError, match="32 bytes, got 5"):
        SigningKey(b"short")


class TestBesidePymavlink:
    """The signing of pymavlink, which MAVProxy uses, on the other side."""

    @staticmethod
    def other_side() -> dialect.MAVLink:
        other = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        other.signing.secret_key = KEY
        other.signing.sign_outgoing = True
        other.signing.timestamp = START
        return other

    def test_it_accepts_what_is_sent(self, signed: SignedLink) -> None:
        other = self.other_side()
        for _ in range(3):
            assert signed.hub.send(signed.link, BEAT)
            (message,) = other.parse_buffer(signed.vehicle.recv(1000))
            assert message.get_type() == "HEARTBEAT"
            assert message.get_signed()
        assert other.signing.goodsig_count == 3
        assert signed.hub.send(signed.hub.links[0], BEAT)
        with pytest.raises(dialect.MAVError, match="Invalid signature"):
            other.parse_buffer(signed.vehicle.recv(1000))

    def test_what_it_sends_is_accepted(self, signed: SignedLink) -> None:
        other = self.other_side()
        frames = []
        for _ in range(3):
            frames.append(BEAT.pack(other))
            other.seq += 1
        assert [packet.message.get_seq() for packet in signed.hear(*frames)] == [0, 1, 2]
