// What the server has told so far. Updates carry only what changed; null removes a device.

const TRACK_POINTS = 200;
const TRACK_STEP_M = 3;
const MAX_EVENTS = 500;

export class Store {
  constructor() {
    this.clear();
  }

  clear() {
    this.uavs = new Map();
    this.devices = new Map();
    this.tracks = new Map();
    this.plan = null;
    this.planSince = 0;
    this.health = null;
    this.events = [];
    this.page = null;
  }

  /** Take in a message; returns what it changed, as the same keys with names or true. */
  apply(message) {
    if (message.type === "snapshot") {
      this.clear();
      this.page = message.page;
      for (const [name, points] of Object.entries(message.tracks)) this.tracks.set(name, points);
    }
    const changed = {
      all: message.type === "snapshot",
      uavs: Object.keys(message.uavs ?? {}),
      devices: Object.keys(message.devices ?? {}),
      plan: message.plan !== undefined,
      goals: Object.values(message.uavs ?? {}).some((uav) => uav.goal !== undefined || uav.serving !== undefined),
      health: message.health !== undefined,
      events: 0,
    };
    for (const name of changed.uavs) this.#mergeUav(name, message.uavs[name]);
    for (const name of changed.devices) this.#mergeDevice(name, message.devices[name]);
    if (changed.plan) {
      this.plan = message.plan;
      this.planSince = Date.now();
    }
    if (changed.health) this.health = message.health;
    const last = this.events.at(-1)?.number ?? 0;
    const fresh = (message.events ?? []).filter((event) => event.number > last);
    this.events = [...this.events, ...fresh].slice(-MAX_EVENTS);
    changed.events = fresh.length;
    return changed;
  }

  /** How a device is served: served, planned, interrupted, unserved or waiting. */
  service(device, id) {
    if (device.reason) return "unserved";
    if (device.cell === null || device.cell === undefined) return "waiting";
    if (this.isServing(this.cellOf(device)?.uav)) return "served";
    // Until the aircraft that is to serve it has arrived.
    return this.plan?.interrupted.includes(id) ? "interrupted" : "planned";
  }

  /** Whether an aircraft is heard of and at the place from which it serves its cell of the plan. */
  isServing(name) {
    return this.uavs.get(name)?.serving === true;
  }

  /** Cell of the plan that serves a device, or that a UAV flies; undefined if there is none. */
  cellOf(device) {
    return device.cell === null || device.cell === undefined ? undefined : this.plan?.cells[device.cell];
  }

  cellOfUav(name) {
    return this.plan?.cells.find((cell) => cell.uav === name);
  }

  #mergeUav(name, fields) {
    const uav = this.uavs.get(name) ?? {};
    Object.assign(uav, fields);
    this.uavs.set(name, uav);
    if (fields.x === undefined && fields.y === undefined) return;
    const track = this.tracks.get(name) ?? [];
    const last = track.at(-1);
    if (!last || Math.hypot(last[0] - uav.x, last[1] - uav.y) >= TRACK_STEP_M) {
      track.push([uav.x, uav.y]);
      if (track.length > TRACK_POINTS) track.shift();
      this.tracks.set(name, track);
    }
  }

  #mergeDevice(name, fields) {
    if (fields === null) this.devices.delete(name);
    else this.devices.set(name, { ...this.devices.get(name), ...fields });
  }
}
