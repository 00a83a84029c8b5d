// What was last clicked on the map, in words.

import { count, metres, percent, rate } from "./format.js";

const SERVICE = { served: "served", planned: "planned, its aircraft is not there yet", interrupted: "interrupted on the way", unserved: "not served", waiting: "waiting for a plan" };

export class Details {
  constructor(store, onClose) {
    this.store = store;
    this.element = document.getElementById("details");
    this.onClose = onClose;
    this.shown = null;
  }

  show(picked) {
    this.shown = picked;
    this.draw();
  }

  update(changed) {
    if (this.shown && (changed.all || changed.plan || changed.goals || changed.uavs.includes(this.shown[1]) || changed.devices.includes(this.shown[1]))) this.draw();
  }

  draw() {
    const rows = this.shown && (this.shown[0] === "uav" ? this.#uav(this.shown[1]) : this.#device(this.shown[1]));
    this.element.hidden = !rows;
    if (!rows) return;
    const text = JSON.stringify(rows);
    if (text === this.text && this.element.children.length) return;
    this.text = text;
    const head = Object.assign(document.createElement("h2"), { textContent: this.shown[1] });
    const close = Object.assign(document.createElement("button"), { type: "button", className: "quiet", textContent: "×" });
    close.setAttribute("aria-label", "Close details");
    close.onclick = () => this.onClose();
    const list = document.createElement("dl");
    for (const [term, value] of rows) {
      if (!value) continue;
      list.append(Object.assign(document.createElement("dt"), { textContent: term }), Object.assign(document.createElement("dd"), { textContent: value }));
    }
    this.element.replaceChildren(head, close, list);
  }

  #uav(name) {
    const uav = this.store.uavs.get(name);
    if (!uav) return null;
    const cell = this.store.cellOfUav(name);
    return [
      ["Mode", [uav.mode || "unknown", uav.armed ? "armed" : "", uav.landed].filter(Boolean).join(", ")],
      ["At", uav.x === undefined ? "" : place([uav.x, uav.y, uav.z])],
      ["Goal", [uav.goal, uav.goal_at && uav.goal !== "none" ? place(uav.goal_at) : ""].filter(Boolean).join(", ")],
      ["Distance", uav.goal === "none" ? "" : metres(uav.distance)],
      ["Reason", uav.reason],
      ["Battery", percent(uav.battery)],
      ["Serves", cell ? `${count(cell.devices, "device")}, ${rate(cell.rate)}` : "no cell"],
    ];
  }

  #device(id) {
    const device = this.store.devices.get(id);
    if (!device) return null;
    const cell = this.store.cellOf(device);
    return [
      ["Service", SERVICE[this.store.service(device, id)]],
      ["Demand", rate(device.demand)],
      ["Planned rate", device.rate === null ? "" : rate(device.rate)],
      ["By", cell ? cell.uav || "no aircraft yet" : ""],
      ["Weight", device.weight === 1 ? "" : String(device.weight)],
      ["Reason", device.reason],
      ["At", place([device.x, device.y])],
    ];
  }
}

function place([east, north, up]) {
  return `${Math.round(east)} E, ${Math.round(north)} N${up === undefined ? "" : `, ${Math.round(up)} m up`}`;
}
