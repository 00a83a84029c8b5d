"""What went over a link: counts, rates and losses, for the link and for each source heard on it."""

from __future__ import annotations

from dataclasses import dataclass, field

from jpap_ros.mavlink.signing import Verdict

WINDOW_S = 5
_MAX_SOURCES = 512
_OUTAGE_S = 5.0
_LOSS_WINDOW_S = 10.0
_HISTORY = (1 << 128) - 1


class Traffic:
    """Messages and bytes, in all and per second over the last whole seconds (`WINDOW_S` of them)."""

    __slots__ = ("_buckets", "_second", "bytes", "messages")

    def __init__(self) -> None:
        self.messages = 0
        self.bytes = 0
        self._buckets = [[0, 0] for _ in range(WINDOW_S + 1)]
        self._second = 0

    def add(self, size: int, now: float) -> None:
        """Count one message of `size` bytes at monotonic time `now` [s]."""
        self.messages += 1
        self.bytes += size
        self._roll(int(now))
        bucket = self._buckets[0]
        bucket[0] += 1
        bucket[1] += size

    def rates(self, now: float) -> tuple[float, float]:
        """Messages/s and bytes/s, without the second that is still running."""
        self._roll(int(now))
        complete = self._buckets[1:]
        return sum(b[0] for b in complete) / WINDOW_S, sum(b[1] for b in complete) / WINDOW_S

    def _roll(self, second: int) -> None:
        if second == self._second:
            return
        passed = min(max(second - self._second, 0), WINDOW_S + 1)
        self._buckets = [[0, 0] for _ in range(passed)] + self._buckets[: WINDOW_S + 1 - passed]
        self._second = second


class SourceStatistics:
    """Messages of one (system, component) on one link.

    Attributes
    ----------
    traffic : Traffic
    lost : int
        Messages missing from the sequence numbers. A gap over an outage of 5 s or more is not counted: the number
        has 8 bits and the sender may have started anew.
    duplicates : int
    last_heard : float
        Monotonic time [s].
    """

    __slots__ = ("_last", "_seen", "duplicates", "last_heard", "lost", "traffic")

    def __init__(self) -> None:
        self.traffic = Traffic()
        self.lost = 0
        self.duplicates = 0
        self.last_heard = float("-inf")
        self._last = 0
        # Bit k: the message k before the last one came.
        self._seen = 0

    @property
    def loss(self) -> float:
        """Share of messages lost, 0 to 1."""
        expected = self.traffic.messages - self.duplicates + self.lost
        return self.lost / expected if expected else 0.0

    def add(self, sequence: int, size: int, now: float) -> None:
        """Count one message."""
        step = (sequence - self._last) % 256
        if now - self.last_heard > _OUTAGE_S:
            self._seen = 1
            self._last = sequence
        elif 0 < step < 128:
            self.lost += step - 1
            self._seen = (self._seen << step | 1) & _HISTORY
            self._last = sequence
        else:
            bit = 1 << (-step % 256)
            if self._seen & bit:
                self.duplicates += 1
            elif self.lost:
                # Late, and counted as lost when the later ones came.
                self.lost -= 1
            self._seen |= bit
        self.last_heard = now
        self.traffic.add(size, now)


@dataclass
class LinkStatistics:
    """Everything counted on one link.

    Attributes
    ----------
    received, sent : Traffic
        Good frames, after the check of signatures; frames put on the wire, own and forwarded.
    dropped : int
        Frames of ours that were not sent: link down, nobody to send to, or its buffer full.
    over_budget : int
        Forwarded frames dropped for the link's byte budget.
    skipped_bytes, bad_frames, unknown_frames : int
        Bytes between frames; frames with a wrong checksum; frames with an id that is not in our dialect.
    refused : dict of Verdict to int
        Frames refused on a link with a key: unsigned, badly signed, replayed.
    refusals : Traffic
        The same by time.
    recent_loss : float
        Share of messages lost over all sources in the last complete 10 s, 0 to 1.
    sources : dict of (system, component) to SourceStatistics
    """

    received: Traffic = field(default_factory=Traffic)
    sent: Traffic = field(default_factory=Traffic)
    dropped: int = 0
    over_budget: int = 0
    skipped_bytes: int = 0
    bad_frames: int = 0
    unknown_frames: int = 0
    refused: dict[Verdict, int] = field(default_factory=lambda: dict.fromkeys(Verdict, 0))
    refusals: Traffic = field(default_factory=Traffic)
    recent_loss: float = 0.0
    sources: dict[tuple[int, int], SourceStatistics] = field(default_factory=dict)
    _window_began: float = float("-inf")
    _window_totals: tuple[int, int] = (0, 0)

    @property
    def loss(self) -> float:
        """Share of messages lost over all sources since the start, 0 to 1."""
        lost, came = self._totals()
        return lost / (lost + came) if lost + came else 0.0

    def _totals(self) -> tuple[int, int]:
        sources = self.sources.values()
        return sum(s.lost for s in sources), sum(s.traffic.messages - s.duplicates for s in sources)

    def count_received(self, source: tuple[int, int], sequence: int, size: int, now: float) -> None:
        """Count one good frame."""
        self.received.add(size, now)
        statistics = self.sources.get(source)
        if statistics is None:
            if len(self.sources) >= _MAX_SOURCES:
                # Noise can look like thousands of sources.
                del self.sources[min(self.sources, key=lambda key: self.sources[key].last_heard)]
            statistics = self.sources[source] = SourceStatistics()
        statistics.add(sequence, size, now)
        if now - self._window_began >= _LOSS_WINDOW_S:
            totals = self._totals()
            # Messages that come late, and sources forgotten, make the totals fall.
            lost, came = (max(0, new - old) for new, old in zip(totals, self._window_totals, strict=True))
            self.recent_loss = lost / (lost + came) if lost + came else 0.0
            self._window_began, self._window_totals = now, totals

    def count_refused(self, verdict: Verdict, size: int, now: float) -> None:
        """Count one frame refused for its signature, or for having none."""
        self.refused[verdict] += 1
        self.refusals.add(size, now)
