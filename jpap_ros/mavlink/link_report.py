"""How a link is doing, as a value that other threads may keep."""

from __future__ import annotations

from dataclasses import dataclass

from jpap_ros.mavlink.link import Link
from jpap_ros.mavlink.signing import Verdict


@dataclass(frozen=True)
class LinkReport:
    """State of one link at one time.

    Attributes
    ----------
    url : str
    up : bool
    problem : str
        Why it is down, or why its signing state cannot be stored; empty if all is well.
    signed : bool
        Whether it has a key.
    peers : int
        Remote ends that sent a good message lately.
    received_per_s, sent_per_s, received_bytes_per_s, sent_bytes_per_s : float
        Over the last seconds.
    max_bytes_per_s : float or None
    loss : float
        Share of messages missing from the sequence numbers over the last 10 s, 0 to 1.
    source_loss : tuple of (system, component, loss)
        Since the start.
    dropped, over_budget, bad_frames, skipped_bytes, reconnects : int
        Since the start; see `LinkStatistics`.
    refused_per_s : float
        Frames refused for their signature, or for having none, over the last seconds.
    unsigned, badly_signed, replayed : int
        Frames refused since the start.
    """

    url: str
    up: bool
    problem: str
    signed: bool
    peers: int
    received_per_s: float
    sent_per_s: float
    received_bytes_per_s: float
    sent_bytes_per_s: float
    max_bytes_per_s: float | None
    loss: float
    source_loss: tuple[tuple[int, int, float], ...]
    dropped: int
    over_budget: int
    bad_frames: int
    skipped_bytes: int
    reconnects: int
    refused_per_s: float
    unsigned: int
    badly_signed: int
    replayed: int

    @classmethod
    def of(cls, link: Link, now: float) -> LinkReport:
        """Report on a link at monotonic time `now` [s]; on the hub's thread."""
        statistics, signer = link.statistics, link.options.signer
        received = statistics.received.rates(now)
        sent = statistics.sent.rates(now)
        return cls(
            url=str(link.url),
            up=link.up,
            problem=link.problem or (signer.problem if signer else ""),
            signed=signer is not None,
            peers=sum(peer.trusted for peer in link.peers),
            received_per_s=received[0],
            sent_per_s=sent[0],
            received_bytes_per_s=received[1],
            sent_bytes_per_s=sent[1],
            max_bytes_per_s=link.options.max_bytes_per_s,
            loss=statistics.recent_loss,
            source_loss=tuple((*source, known.loss) for source, known in sorted(statistics.sources.items())),
            dropped=statistics.dropped,
            over_budget=statistics.over_budget,
            bad_frames=statistics.bad_frames,
            skipped_bytes=statistics.skipped_bytes,
            reconnects=link.reconnects,
            refused_per_s=statistics.refusals.rates(now)[0],
            unsigned=statistics.refused[Verdict.UNSIGNED],
            badly_signed=statistics.refused[Verdict.FORGED],
            replayed=statistics.refused[Verdict.REPLAYED],
        )
