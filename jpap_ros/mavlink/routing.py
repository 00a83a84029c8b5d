"""Lets ground stations see and command the fleet through the bridge's links.

Follows https://mavlink.io/en/guide/routing.html: a frame without a target goes to all, one with a target only where
that target was heard, never back to where it came from, and unchanged. Three things are narrower here:

- Nothing goes from one vehicle to another: only ground stations and the bridge command. Broadcasts would load the links
  of N vehicles N times over, and a garbled or forged frame on one link would reach the whole fleet.
- A vehicle with several links is sent everything once, and its broadcasts are taken from one of them, so that a
  ground station's command does not arrive twice.
- SETUP_SIGNING, which carries a key, is never forwarded.

Signing: frames are forwarded as they came, so a frame can only go to a link with a key if it was itself signed with
that key, that is, if it came over a link with the same key. An unsigned ground station therefore cannot command signed
vehicles. The bridge does not sign for it: that would hand the key's authority to whoever reaches the port.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.mavlink.link import Link, Peer
from jpap_ros.mavlink.links import LinkHub, Packet

Source = tuple[int, int]
"""System and component id."""
Route = tuple[Link, Peer]

_SILENT_S = 3.5
_FORGET_S = 60.0
_MAX_SOURCES = 1024

URGENT_IDS = frozenset(
    {
        dialect.MAVLINK_MSG_ID_HEARTBEAT,
        dialect.MAVLINK_MSG_ID_SET_MODE,
        dialect.MAVLINK_MSG_ID_MANUAL_CONTROL,
        dialect.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE,
        dialect.MAVLINK_MSG_ID_COMMAND_INT,
        dialect.MAVLINK_MSG_ID_COMMAND_LONG,
        dialect.MAVLINK_MSG_ID_COMMAND_ACK,
        dialect.MAVLINK_MSG_ID_STATUSTEXT,
    }
)
"""Messages by which a pilot takes over, and the answers: no byte budget holds them back."""


def target_of(message: dialect.MAVLink_message) -> Source:
    """System and component a message is for; 0 means all."""
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_MANUAL_CONTROL:
        return int(message.target), 0
    return int(getattr(message, "target_system", 0)), int(getattr(message, "target_component", 0))


class RouteTable:
    """Where each (system, component) was heard."""

    def __init__(self) -> None:
        self._heard: dict[Source, dict[Route, float]] = {}

    def learn(self, source: Source, route: Route, now: float) -> None:
        """Note that a source was heard on a route."""
        routes = self._heard.get(source)
        if routes is None:
            if len(self._heard) >= _MAX_SOURCES:
                del self._heard[min(self._heard, key=lambda key: max(self._heard[key].values()))]
            routes = self._heard[source] = {}
        if route not in routes:
            for stale in [known for known, heard in routes.items() if now - heard > _FORGET_S]:
                del routes[stale]
        routes[route] = now

    def routes(self, source: Source, now: float) -> tuple[Route, ...]:
        """Routes that a source was heard on within a minute, in the order they were found."""
        return tuple(route for route, heard in self._heard.get(source, {}).items() if now - heard <= _FORGET_S)

    def primary(self, source: Source, now: float) -> Route | None:
        """The one route to use: the first found that is not silent, or else the last heard."""
        routes = self._heard.get(source, {})
        for route, heard in routes.items():
            if now - heard <= _SILENT_S:
                return route
        known = self.routes(source, now)
        return max(known, key=lambda route: routes[route]) if known else None

    def sources(self, system: int = 0, component: int = 0) -> tuple[Source, ...]:
        """Sources heard that match a target; 0 matches all."""
        if system and component:
            return ((system, component),) if (system, component) in self._heard else ()
        return tuple(s for s in self._heard if system in (0, s[0]) and component in (0, s[1]))


class Forwarder:
    """Carries frames between ground stations and vehicles. Feed it every packet that the hub's `poll` returns.

    Parameters
    ----------
    hub : LinkHub
    own : tuple of (system, component)
        Our identity: what is for us stays here, and what claims to be from us is dropped.
    gcs_links : collection of Link
        Links to ground stations; all others are links to vehicles.
    fleet : collection of int
        System ids of the vehicles: they alone live on vehicle links, whoever else is heard on a ground station's link
        is a station. See Notes.

    Attributes
    ----------
    forwarded : int
        Frames passed on; once for each that received it.
    unroutable : int
        Frames whose target was not heard anywhere that they may go to.
    refused_for_signing : int
        Frames not passed on to a link with a key that they are not signed with.
    looped : int
        Frames dropped because they came back to us: our own, a vehicle's by way of a ground station, or a station's
        by way of a vehicle.

    Notes
    -----
    Loops close on both sides: a ground station with a link of its own to a vehicle passes that vehicle's frames on,
    and an autopilot passes broadcasts on from one of its ports to the others, so that a vehicle with two links, or
    with a second radio, returns the stations' heartbeats. Of two copies the one from where the source lives counts. A
    station is never taken for a vehicle because a vehicle repeats it: that would shut out the pilot. Another station
    with the same id on a vehicle's own radio cannot be told from such an echo, and is not heard while the first is.
    """

    def __init__(self, hub: LinkHub, own: Source, gcs_links: Collection[Link], fleet: Collection[int]) -> None:
        self._hub = hub
        self._own = own
        self._gcs_links = frozenset(gcs_links)
        self._fleet = frozenset(fleet)
        self._vehicles = RouteTable()
        self._stations = RouteTable()
        self.forwarded = 0
        self.unroutable = 0
        self.refused_for_signing = 0
        self.looped = 0

    def on_packet(self, packet: Packet) -> bool:
        """Learn where a packet's source is, and pass it on to whom it is for.

        Returns
        -------
        bool
            False if it is a loop and should not be looked at any further.
        """
        message, now = packet.message, packet.received_at
        source = (message.get_srcSystem(), message.get_srcComponent())
        arrival = (packet.link, packet.peer)
        from_station = packet.link in self._gcs_links
        if source == self._own or self._is_echo(source, from_station, now):
            self.looped += 1
            return False
        # Component 0 means all of them and cannot be a source to send to.
        # RADIO_STATUS may come unsigned on a link with a key, and then proves nothing about where its source is.
        proven = packet.link.options.signer is None or message.get_msgId() != dialect.MAVLINK_MSG_ID_RADIO_STATUS
        if source[0] and source[1] and proven:
            (self._stations if from_station else self._vehicles).learn(source, arrival, now)
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_SETUP_SIGNING:
            return True
        target = target_of(message)
        if target[0] == 0:
            routes = self._for_all(source, arrival, from_station, now)
        elif target == self._own:
            return True
        else:
            routes = list(dict.fromkeys(self._addressed(target, from_station, now)))
            if not routes and target[0] != self._own[0]:
                self.unroutable += 1
        self._pass_on(packet, [route for route in routes if route != arrival])
        return True

    def _is_echo(self, source: Source, from_station: bool, now: float) -> bool:
        """Whether a source lives on the other side and was heard there within a minute."""
        if source[0] in self._fleet:
            return from_station and bool(self._vehicles.routes(source, now))
        return not from_station and bool(self._stations.routes(source, now))

    def _for_all(self, source: Source, arrival: Route, from_station: bool, now: float) -> list[Route]:
        stations = [(link, peer) for link in self._gcs_links for peer in link.peers]
        if from_station:
            primaries = (self._vehicles.primary(vehicle, now) for vehicle in self._vehicles.sources())
            return stations + list(dict.fromkeys(route for route in primaries if route is not None))
        return stations if self._vehicles.primary(source, now) in (arrival, None) else []

    def _addressed(self, target: Source, from_station: bool, now: float) -> Iterator[Route]:
        for vehicle in self._vehicles.sources(*target) if from_station else ():
            route = self._vehicles.primary(vehicle, now)
            if route is not None:
                yield route
        for station in self._stations.sources(*target):
            yield from self._stations.routes(station, now)

    def _pass_on(self, packet: Packet, routes: list[Route]) -> None:
        if not routes:
            return
        frame = bytes(packet.message.get_msgbuf())
        urgent = packet.message.get_msgId() in URGENT_IDS
        here = packet.link.options.signer
        for link, peer in routes:
            there = link.options.signer
            if there is not None and (here is None or here.key != there.key):
                self.refused_for_signing += 1
            elif self._hub.forward(link, frame, peer, urgent):
                self.forwarded += 1
