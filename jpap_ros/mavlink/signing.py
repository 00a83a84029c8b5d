"""MAVLink 2 message signing: keys, timestamps that never go back, and the check of what comes in.

Follows https://mavlink.io/en/guide/message_signing.html. pymavlink signs outgoing frames; incoming ones are checked
here, because its own check advances a stream's timestamp before it has looked at the signature (one forged frame with
a timestamp in the far future would silence the real vehicle), and lets frames with unknown message ids pass.
"""

from __future__ import annotations

import contextlib
import enum
import hashlib
import hmac
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.fleet.secret_file import read_secret
from jpap_ros.mavlink.frame import MAVLINK2_MAGIC, SIGNATURE_BLOCK_BYTES, SIGNED_FLAG

EPOCH_UNIX_S = 1_420_070_400
"""1 January 2015 GMT in Unix time: where signing timestamps begin."""
TICKS_PER_S = 100_000
"""Signing timestamps count units of 10 us."""

_KEY_BYTES = 32
_SIGNATURE_BYTES = 6
_NEW_STREAM_TOLERANCE = 60 * TICKS_PER_S
# Short, since a crash costs this much advance on the true time, and a ground station a minute behind is locked out.
_RESERVED = 10 * TICKS_PER_S
_MAX_TIMESTAMP = (1 << 48) - 1


class SigningError(ValueError):
    """A key or state file cannot be used; the message names the file, never the key."""


class Verdict(enum.Enum):
    """What the check of a frame's signature found."""

    GOOD = "good"
    UNSIGNED = "unsigned"
    FORGED = "badly signed"
    REPLAYED = "replayed or too old"


@dataclass(frozen=True)
class SigningKey:
    """A secret of 32 bytes, shown nowhere."""

    secret: bytes = field(repr=False)

    def __post_init__(self) -> None:
        if len(self.secret) != _KEY_BYTES:
            raise SigningError(f"a signing key has {_KEY_BYTES} bytes, got {len(self.secret)}")

    @classmethod
    def load(cls, path: Path) -> SigningKey:
        """Read a key file: 64 hexadecimal digits, or a passphrase whose SHA-256 is the key.

        Raises
        ------
        SigningError
            If the file cannot be read, is empty, or can be read by others than its owner.
        """
        try:
            text = read_secret(path)
        except ValueError as error:
            raise SigningError(f"signing key file {path}: {error}") from None
        if not text:
            raise SigningError(f"signing key file {path}: must hold 64 hexadecimal digits or a passphrase")
        if len(text) == 2 * _KEY_BYTES:
            with contextlib.suppress(ValueError):
                return cls(bytes.fromhex(text.decode("ascii")))
        return cls(hashlib.sha256(text).digest())


class Signer:
    """Timestamps and checks for all links that share one key.

    Parameters
    ----------
    key : SigningKey
    state_file : Path
        Where the timestamp outlives the process. Written anew, and whole, every few seconds.
    clock : callable
        Unix time [s].

    Attributes
    ----------
    problem : str
        Why the state could not be written the last time; empty if it could.

    Raises
    ------
    SigningError
        If the state file cannot be read or written, or is damaged.
    """

    def __init__(self, key: SigningKey, state_file: Path, clock: Callable[[], float] = time.time) -> None:
        self.key = key
        self.problem = ""
        self._state_file = state_file
        self._clock = clock
        self._streams: dict[tuple[int, int, int], int] = {}
        # What was stored lies ahead of every timestamp that was used.
        self._timestamp = self._reserved = max(self._clock_ticks(), self._stored())
        self._reserve()
        if self.problem:
            raise SigningError(self.problem)

    @classmethod
    def load(cls, key_file: Path) -> Signer:
        """Signer for a key file, with its state in `<key file>.timestamp`; SigningError if either is unusable."""
        return cls(SigningKey.load(key_file), key_file.with_name(key_file.name + ".timestamp"))

    def next_timestamp(self) -> int:
        """Timestamp of the next frame to send: now, or one more than the last if that is later."""
        self._timestamp = max(self._timestamp + 1, self._clock_ticks())
        if self._timestamp >= self._reserved:
            self._reserve()
        return self._timestamp

    def sign(self, packer: dialect.MAVLink, link_id: int) -> None:
        """Make `packer` sign the next message it packs."""
        packer.signing.secret_key = self.key.secret
        packer.signing.sign_outgoing = True
        packer.signing.link_id = link_id % 256
        packer.signing.timestamp = self.next_timestamp()

    def check(self, frame: bytes | bytearray) -> Verdict:
        """Check a whole frame whose checksum is right; remembers the timestamp only of a good one."""
        if frame[0] != MAVLINK2_MAGIC or not frame[2] & SIGNED_FLAG:
            return Verdict.UNSIGNED
        digest = hashlib.sha256(self.key.secret)
        digest.update(frame[:-_SIGNATURE_BYTES])
        if not hmac.compare_digest(digest.digest()[:_SIGNATURE_BYTES], bytes(frame[-_SIGNATURE_BYTES:])):
            return Verdict.FORGED
        link_id = frame[-SIGNATURE_BLOCK_BYTES]
        timestamp = int.from_bytes(frame[-SIGNATURE_BLOCK_BYTES + 1 : -_SIGNATURE_BYTES], "little")
        stream = (frame[5], frame[6], link_id)
        last = self._streams.get(stream)
        if last is None:
            last = max(self._timestamp, self._clock_ticks()) - _NEW_STREAM_TOLERANCE - 1
        if timestamp <= last:
            return Verdict.REPLAYED
        self._streams[stream] = timestamp
        self._timestamp = max(self._timestamp, timestamp)
        return Verdict.GOOD

    def close(self) -> None:
        """Store the timestamp as it is, so that a quick restart does not run ahead of the time."""
        self._store(self._timestamp + 1)

    def _clock_ticks(self) -> int:
        return min(max(0, int((self._clock() - EPOCH_UNIX_S) * TICKS_PER_S)), _MAX_TIMESTAMP)

    def _reserve(self) -> None:
        self._reserved = self._timestamp + _RESERVED
        self._store(self._reserved)

    def _stored(self) -> int:
        try:
            text = self._state_file.read_text(encoding="ascii")
        except FileNotFoundError:
            return 0
        except (OSError, UnicodeDecodeError) as error:
            raise SigningError(f"signing state file {self._state_file}: cannot be read: {error}") from None
        if not text.strip().isdigit() or int(text) > _MAX_TIMESTAMP:
            raise SigningError(f"signing state file {self._state_file}: must hold a timestamp, got {text[:40]!r}")
        return int(text)

    def _store(self, timestamp: int) -> None:
        # Not fsync: it could hold up the aircraft's thread, and after a power cut the clock is ahead of the file.
        temporary = self._state_file.with_name(f"{self._state_file.name}.{os.getpid()}")
        try:
            temporary.write_text(f"{timestamp}\n", encoding="ascii")
            temporary.replace(self._state_file)
        except OSError as error:
            self.problem = f"signing state file {self._state_file}: cannot be written: {error.strerror}"
        else:
            self.problem = ""

    def __repr__(self) -> str:
        return f"Signer({self._state_file})"
