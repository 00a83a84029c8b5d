// Everything on the map, drawn on three canvases: what changes with a plan, the tracks, and what flies.

import * as symbols from "./symbols.js";

const FLYING_GOALS = new Set(["sent", "accepted", "en route", "reached"]);

export class Scene {
  /**
   * @param map Leaflet map
   * @param frame MetricFrame or GeodeticFrame
   * @param store Store
   */
  constructor(map, frame, store) {
    this.map = map;
    this.frame = frame;
    this.store = store;
    this.layers = { links: true, coverage: true, tracks: true, labels: true };
    this.selected = new Set();
    this.picked = null;
    this.places = new Map();
    this.shown = new Map();
    this.ground = this.#canvas();
    this.trails = this.#canvas();
    this.sky = this.#canvas();
    this.redraw();
    this.calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    map.on("move zoom resize viewreset", () => this.redraw());
    new ResizeObserver(() => {
      map.invalidateSize();
      this.redraw();
    }).observe(map.getContainer());
    this.frames = 0;
    const loop = () => {
      this.frames += 1;
      this.#draw();
      requestAnimationFrame(loop);
    };
    requestAnimationFrame(loop);
  }

  redraw() {
    this.groundDue = this.trailsDue = this.skyDue = true;
  }

  /** Take in what an update changed. */
  update(changed) {
    if (changed.all) {
      this.places.clear();
      this.shown.clear();
    }
    for (const name of changed.devices) this.places.delete(name);
    if (changed.all || changed.plan || changed.devices.length || changed.goals) this.groundDue = true;
    const now = performance.now();
    for (const name of changed.uavs) {
      const uav = this.store.uavs.get(name);
      if (uav.x === undefined) continue;
      // From where it is drawn now to where it is, in the time until the next update.
      const from = this.#position(name, uav, now);
      this.shown.set(name, { from, to: [uav.x, uav.y], since: now });
    }
    if (changed.uavs.length || changed.all) this.trailsDue = this.skyDue = true;
  }

  /** Everything's corners, for the map to show; null if there is nothing. */
  bounds() {
    const reach = this.#reach();
    const items = [...this.store.devices.values(), ...this.store.uavs.values()].filter((item) => item.x !== undefined);
    const points = [...items.map((item) => [item.x, item.y]), ...(this.store.plan?.cells ?? []).flatMap(({ at }, i) => [[at[0] - reach[i], at[1] - reach[i]], [at[0] + reach[i], at[1] + reach[i]]])];
    return points.length ? L.latLngBounds(points.map(([east, north]) => this.frame.toLatLng(east, north))) : null;
  }

  /** Radius of each cell [m]: the scheme's own, else as far as its farthest device. */
  #reach() {
    const cells = this.store.plan?.cells ?? [];
    const reach = cells.map((cell) => cell.radius ?? 0);
    for (const device of this.store.devices.values()) {
      const cell = this.store.cellOf(device);
      if (cell && cell.radius === null) reach[device.cell] = Math.max(reach[device.cell], Math.hypot(device.x - cell.at[0], device.y - cell.at[1]));
    }
    return reach;
  }

  /** Aircraft or device near a point of the map's container, as [kind, name]; null if there is none. */
  hit(point) {
    const view = this.#view();
    let [best, distance] = [null, 18];
    const consider = (kind, name, u, v, reach) => {
      const [x, y] = view.at(u, v);
      const away = Math.hypot(x - point.x, y - point.y);
      if (away < distance && away < reach) [best, distance] = [[kind, name], away];
    };
    for (const [name, uav] of this.store.uavs) {
      if (uav.x !== undefined) consider("uav", name, ...this.#world(uav.x, uav.y), 18);
    }
    if (best) return best;
    for (const name of this.store.devices.keys()) consider("device", name, ...this.#place(name), 12);
    return best;
  }

  #canvas() {
    const canvas = L.DomUtil.create("canvas", "scene", this.map.getContainer());
    canvas.setAttribute("aria-hidden", "true");
    return canvas;
  }

  #draw() {
    if (!this.groundDue && !this.skyDue && !this.moving) return;
    const view = this.#view();
    if (this.groundDue) this.#drawGround(view);
    if (this.trailsDue) this.#drawTrails(view);
    this.#drawSky(view);
    this.groundDue = this.trailsDue = this.skyDue = false;
  }

  /** From world pixels at zoom 0 to pixels of the container. */
  #view() {
    const scale = this.map.getZoomScale(this.map.getZoom(), 0);
    const corner = this.map.getPixelBounds().min;
    const [u] = this.#world(0, 0);
    const perMetre = (this.#world(1, 0)[0] - u) * scale;
    return { scale, perMetre, at: (x, y) => [x * scale - corner.x, y * scale - corner.y] };
  }

  #world(east, north) {
    const point = this.map.project(this.frame.toLatLng(east, north), 0);
    return [point.x, point.y];
  }

  #place(name) {
    let place = this.places.get(name);
    if (!place) {
      const device = this.store.devices.get(name);
      place = this.#world(device.x, device.y);
      this.places.set(name, place);
    }
    return place;
  }

  #position(name, uav, now) {
    const shown = this.shown.get(name);
    if (!shown || this.calm) return [uav.x, uav.y];
    const share = Math.min(1, (now - shown.since) / (1000 * this.store.page.update_s));
    // A jump (a reconnect, a new simulation) is not flown.
    if (Math.hypot(shown.to[0] - shown.from[0], shown.to[1] - shown.from[1]) > 100) return shown.to;
    return shown.from.map((value, axis) => value + share * (shown.to[axis] - value));
  }

  #begin(canvas) {
    const { x: width, y: height } = this.map.getSize();
    const ratio = window.devicePixelRatio || 1;
    const [wide, high] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== wide || canvas.height !== high) {
      canvas.width = wide;
      canvas.height = high;
      canvas.style.width = `${width}px`;
      canvas.style.height = `${height}px`;
    }
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    return { context, width, height };
  }

  #drawGround(view) {
    const { context, width, height } = this.#begin(this.ground);
    const style = getComputedStyle(this.map.getContainer());
    if (!this.store.page?.tile_url) this.#drawGrid(context, view, width, height, style.getPropertyValue("--grid"));
    this.#drawFence(context, view);
    const cells = this.store.plan?.cells ?? [];
    const seen = (x, y, reach) => x > -reach && y > -reach && x < width + reach && y < height + reach;
    const radii = this.#reach();
    const members = cells.map(() => []);
    for (const [name, device] of this.store.devices) {
      if (device.cell !== null && device.cell !== undefined) members[device.cell]?.push(view.at(...this.#place(name)));
    }
    cells.forEach((cell, i) => {
      const [x, y] = view.at(...this.#world(cell.at[0], cell.at[1]));
      const reach = radii[i] * view.perMetre;
      if (!seen(x, y, reach + 20)) return;
      if (this.layers.coverage && reach > 0) {
        context.beginPath();
        context.arc(x, y, reach + 6, 0, 2 * Math.PI);
        context.fillStyle = "rgba(86, 180, 233, 0.13)";
        context.fill();
        context.strokeStyle = "rgba(0, 114, 178, 0.4)";
        context.lineWidth = 1;
        context.stroke();
      }
      if (!this.layers.links) return;
      // Solid where the aircraft is there to serve, faint where it is yet to come.
      const serving = this.store.isServing(cell.uav);
      context.beginPath();
      for (const [dx, dy] of members[i]) {
        context.moveTo(x, y);
        context.lineTo(dx, dy);
      }
      context.strokeStyle = serving ? "rgba(0, 158, 115, 0.75)" : "rgba(0, 158, 115, 0.3)";
      context.lineWidth = serving ? 1.5 : 1;
      context.setLineDash(serving ? [] : [2, 3]);
      context.stroke();
      context.setLineDash([]);
    });
    // Many devices on little room are drawn smaller.
    const small = this.store.devices.size > 300 && view.perMetre < 1 ? 0.6 : 1;
    const highest = Math.max(1e-9, ...[...this.store.devices.values()].map((device) => device.demand));
    for (const [name, device] of this.store.devices) {
      const [x, y] = view.at(...this.#place(name));
      if (!seen(x, y, 20)) continue;
      const r = small * (3.5 + 3.5 * (device.demand / highest));
      if (this.picked === name) {
        context.beginPath();
        context.arc(x, y, r + 7, 0, 2 * Math.PI);
        context.fillStyle = "rgba(240, 228, 66, 0.7)";
        context.fill();
      }
      symbols.device(context, this.store.service(device, name), x, y, r);
    }
  }

  #drawGrid(context, view, width, height, colour) {
    const step = [1, 2, 5].flatMap((n) => [0, 1, 2, 3, 4].map((e) => n * 10 ** e)).sort((a, b) => a - b)
      .find((metres) => metres * view.perMetre >= 60) ?? 100000;
    const size = step * view.perMetre;
    const [x0, y0] = view.at(...this.#world(0, 0));
    context.beginPath();
    for (let x = ((x0 % size) + size) % size; x < width; x += size) {
      context.moveTo(Math.round(x) + 0.5, 0);
      context.lineTo(Math.round(x) + 0.5, height);
    }
    for (let y = ((y0 % size) + size) % size; y < height; y += size) {
      context.moveTo(0, Math.round(y) + 0.5);
      context.lineTo(width, Math.round(y) + 0.5);
    }
    context.strokeStyle = colour;
    context.lineWidth = 1;
    context.stroke();
  }

  #drawFence(context, view) {
    const { circle, polygon } = this.store.page ?? {};
    context.beginPath();
    if (circle) {
      const [x, y] = view.at(...this.#world(circle[0], circle[1]));
      context.arc(x, y, circle[2] * view.perMetre, 0, 2 * Math.PI);
    }
    (polygon ?? []).forEach(([east, north], i) => {
      const [x, y] = view.at(...this.#world(east, north));
      if (i) context.lineTo(x, y);
      else context.moveTo(x, y);
    });
    if (polygon?.length) context.closePath();
    context.strokeStyle = "rgba(213, 94, 0, 0.6)";
    context.lineWidth = 1.5;
    context.setLineDash([8, 5]);
    context.stroke();
    context.setLineDash([]);
  }

  #drawTrails(view) {
    const { context } = this.#begin(this.trails);
    if (!this.layers.tracks) return;
    context.beginPath();
    for (const track of this.store.tracks.values()) {
      track.forEach((point, i) => {
        point.world ??= this.#world(point[0], point[1]);
        const [x, y] = view.at(...point.world);
        if (i) context.lineTo(x, y);
        else context.moveTo(x, y);
      });
    }
    context.strokeStyle = "rgba(0, 114, 178, 0.35)";
    context.lineWidth = 1.5;
    context.stroke();
  }

  #drawSky(view) {
    const { context } = this.#begin(this.sky);
    const now = performance.now();
    const ink = getComputedStyle(this.map.getContainer()).getPropertyValue("--ink");
    const halo = getComputedStyle(this.map.getContainer()).getPropertyValue("--halo");
    this.moving = false;
    const drawn = [];
    for (const [name, uav] of this.store.uavs) {
      if (uav.x === undefined) continue;
      const [east, north] = this.#position(name, uav, now);
      const shown = this.shown.get(name);
      if (shown && (east !== uav.x || north !== uav.y)) this.moving = true;
      drawn.push([name, uav, ...view.at(...this.#world(east, north))]);
    }
    for (const [, uav, x, y] of drawn) {
      if (!uav.goal_at || !FLYING_GOALS.has(uav.goal)) continue;
      const point = view.at(...this.#world(uav.goal_at[0], uav.goal_at[1]));
      if (uav.goal !== "reached") {
        symbols.goal(context, ...point);
        context.setLineDash([6, 4]);
        context.beginPath();
        context.moveTo(x, y);
        context.lineTo(...point);
        context.stroke();
        context.setLineDash([]);
      }
    }
    for (const [name, uav, x, y] of drawn) symbols.uav(context, symbols.kindOf(uav), x, y, uav.heading, this.selected.has(name));
    if (!this.layers.labels) return;
    context.font = "600 11px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "top";
    context.lineWidth = 3;
    context.strokeStyle = halo;
    context.fillStyle = ink;
    // Who flies is named first; a name that would lie on another one is left out.
    const named = [];
    const rank = ([name, uav]) => (this.selected.has(name) ? 0 : symbols.kindOf(uav) === "ground" ? 2 : 1);
    drawn.sort((a, b) => rank(a) - rank(b));
    for (const [name, , x, y] of drawn) {
      if (named.some(([u, v]) => Math.abs(u - x) < 40 && Math.abs(v - y) < 13)) continue;
      named.push([x, y]);
      context.strokeText(name, x, y + 13);
      context.fillText(name, x, y + 13);
    }
  }
}
