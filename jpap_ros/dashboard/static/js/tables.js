// The tables: aircraft, devices and events. A cell is written only where its text has changed.

import { clock, metres, natural, percent, rate, seconds } from "./format.js";
import { kindOf } from "./symbols.js";

const SHOWN_DEVICES = 250;
const GOALS = { none: "no goal", sent: "sent", accepted: "accepted", "en route": "en route", reached: "reached", rejected: "rejected", yielded: "stood down", lost: "lost" };
const SERVICE = { served: "served", planned: "planned, not there yet", interrupted: "interrupted", unserved: "not served", waiting: "waiting" };

const byId = (id) => document.getElementById(id);

export class AircraftTable {
  constructor(store, actions, onShow) {
    this.store = store;
    this.actions = actions;
    this.onShow = onShow;
    this.rows = new Map();
    byId("select-all").onchange = (event) => actions.select(event.target.checked ? store.uavs.keys() : []);
  }

  update(changed) {
    if (changed.all) {
      this.rows.clear();
      byId("aircraft").replaceChildren(...[...this.store.uavs.keys()].sort(natural).map((name) => this.#row(name)));
    }
    for (const name of changed.plan ? this.store.uavs.keys() : changed.uavs) this.#write(name);
  }

  select(names) {
    for (const [name, row] of this.rows) {
      row.box.checked = names.has(name);
      row.tr.classList.toggle("selected", names.has(name));
    }
    const all = byId("select-all");
    all.checked = names.size > 0 && names.size === this.rows.size;
    all.indeterminate = names.size > 0 && names.size < this.rows.size;
  }

  #row(name) {
    const tr = document.createElement("tr");
    const box = Object.assign(document.createElement("input"), { type: "checkbox" });
    box.setAttribute("aria-label", `Select ${name}`);
    box.onchange = () => this.actions.toggle(name);
    const show = Object.assign(document.createElement("button"), { type: "button", className: "link", textContent: name, title: `Show ${name} on the map` });
    show.onclick = () => this.onShow(name);
    const cells = Array.from({ length: 7 }, () => document.createElement("td"));
    cells[0].append(box);
    cells[1].append(show);
    const serves = small(cells[1]);
    const [mode, armed] = [big(cells[2]), small(cells[2])];
    const battery = big(cells[3]);
    const [link, figures] = [big(cells[4]), small(cells[4])];
    const [goal, reason] = [big(cells[5]), small(cells[5])];
    const away = big(cells[6]);
    reason.className = "reason";
    cells[6].className = "number";
    tr.append(...cells);
    this.rows.set(name, { tr, box, serves, mode, armed, battery, link, figures, goal, reason, away });
    return tr;
  }

  #write(name) {
    const row = this.rows.get(name);
    const uav = this.store.uavs.get(name);
    const cell = this.store.cellOfUav(name);
    write(row.serves, cell ? `${cell.devices} dev · ${rate(cell.rate)}` : "");
    write(row.mode, uav.mode || "–");
    write(row.armed, uav.emergency ? "EMERGENCY" : [uav.landed === "undefined" ? "" : uav.landed, uav.armed && uav.landed !== "in air" ? "armed" : ""].filter(Boolean).join(", "));
    write(row.battery, percent(uav.battery));
    mark(row.battery, uav.battery_low ? "bad" : "");
    write(row.link, uav.link === "connected" ? "ok" : uav.link);
    mark(row.link, uav.link === "lost" ? "bad" : uav.link === "connected" ? "good" : "muted");
    const age = Math.max(uav.age ?? 0, uav.link_age ?? 0);
    const loss = uav.loss >= 0.01 ? `${percent(uav.loss)} lost` : "";
    write(row.figures, [age >= 2 ? `${seconds(age)} old` : "", loss].filter(Boolean).join(" · "));
    write(row.goal, uav.taken_over ? "taken over" : GOALS[uav.goal] ?? "–");
    mark(row.goal, uav.taken_over ? "taken" : { reached: "good", rejected: "bad", lost: "bad" }[uav.goal] ?? "");
    write(row.reason, uav.reason ?? "");
    if (row.reason.title !== uav.reason) row.reason.title = uav.reason ?? "";
    write(row.away, metres(uav.goal === "none" ? null : uav.distance));
    const kind = kindOf(uav);
    if (row.tr.dataset.kind !== kind) row.tr.dataset.kind = kind;
  }
}

export class DeviceTable {
  constructor(store, onShow) {
    this.store = store;
    this.onShow = onShow;
    this.due = true;
    byId("device-search").oninput = () => {
      this.due = true;
      this.draw();
    };
  }

  update(changed) {
    if (changed.all || changed.plan || changed.devices.length || changed.goals) this.due = true;
    this.draw();
  }

  draw() {
    if (!this.due || byId("pane-devices").hidden) return;
    this.due = false;
    const wanted = byId("device-search").value.trim().toLowerCase();
    const found = [];
    for (const [id, device] of this.store.devices) {
      const service = this.store.service(device, id);
      const by = this.store.cellOf(device)?.uav ?? "";
      if (!wanted || id.toLowerCase().includes(wanted) || by.toLowerCase() === wanted || SERVICE[service].includes(wanted)) found.push({ id, device, service, by });
    }
    const rank = { unserved: 0, interrupted: 1, planned: 2, waiting: 3, served: 4 };
    found.sort((a, b) => rank[a.service] - rank[b.service] || natural(a.id, b.id));
    byId("devices").replaceChildren(...found.slice(0, SHOWN_DEVICES).map((item) => this.#row(item)));
    const more = found.length - SHOWN_DEVICES;
    byId("devices-more").textContent = more > 0 ? `and ${more} more: search to find them` : found.length ? "" : "No device.";
  }

  #row({ id, device, service, by }) {
    const tr = document.createElement("tr");
    tr.dataset.service = service;
    const show = Object.assign(document.createElement("button"), { type: "button", className: "link", textContent: id, title: `Show ${id} on the map` });
    show.onclick = () => this.onShow(id);
    const cells = Array.from({ length: 5 }, () => document.createElement("td"));
    cells[0].append(show);
    big(cells[1]).textContent = SERVICE[service];
    small(cells[1]).textContent = device.reason;
    cells[2].textContent = rate(device.demand);
    cells[3].textContent = rate(device.rate);
    cells[2].className = cells[3].className = "number";
    cells[4].textContent = by || (device.cell === null ? "–" : "no aircraft");
    tr.append(...cells);
    return tr;
  }
}

export class EventList {
  constructor(store) {
    this.store = store;
    this.unread = 0;
  }

  update(changed) {
    const list = byId("events");
    if (changed.all) list.replaceChildren();
    if (changed.events) {
      list.prepend(...this.store.events.slice(-changed.events).reverse().map(item));
      while (list.children.length > this.store.events.length) list.lastChild.remove();
    }
    const hidden = byId("pane-events").hidden;
    if (!hidden || changed.all) this.unread = 0;
    else this.unread += this.store.events.slice(-changed.events || Infinity).filter((event) => event.level !== "info").length;
    const tab = byId("tab-events");
    const label = this.unread ? `Events (${this.unread} new)` : "Events";
    if (tab.textContent !== label) tab.textContent = label;
  }
}

function item(event) {
  const li = document.createElement("li");
  li.dataset.level = event.level;
  const time = Object.assign(document.createElement("time"), { textContent: clock(event.time_s), dateTime: new Date(1000 * event.time_s).toISOString() });
  const kind = Object.assign(document.createElement("b"), { textContent: { info: "", warning: "Warning", error: "Error" }[event.level] || event.kind });
  const text = Object.assign(document.createElement("span"), { textContent: event.text });
  li.append(time, kind, text);
  return li;
}

function big(cell) {
  return cell.appendChild(document.createElement("span"));
}

function small(cell) {
  return cell.appendChild(document.createElement("small"));
}

function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function mark(element, kind) {
  if (element.className !== kind) element.className = kind;
}
