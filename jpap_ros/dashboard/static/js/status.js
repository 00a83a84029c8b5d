// How planner, bridge, links and this page's own connection are: chips, banner, plan card.

import { count, natural, rate, seconds } from "./format.js";

const LEVELS = ["good", "warn", "bad", "bad"];

const byId = (id) => document.getElementById(id);

export class StatusPanel {
  constructor(store) {
    this.store = store;
    this.state = "connecting";
    this.why = "";
    this.heardAt = 0;
    setInterval(() => this.draw(), 500);
  }

  connection(state, why) {
    this.state = state;
    this.why = why;
    this.draw();
  }

  update(changed) {
    this.heardAt = Date.now();
    if (changed.all || changed.health || changed.goals) this.draw();
    if (changed.all || changed.plan) this.#drawUnserved();
    if (changed.all || changed.plan || changed.devices.length || changed.goals) this.#drawPlan();
  }

  draw() {
    const { health } = this.store;
    const live = this.state === "live";
    chip("page", live ? "good" : "bad", live ? "live" : this.state === "token" ? "token needed" : "lost");
    if (!health) {
      byId("last-data").textContent = live ? "no data yet" : "";
      banner(live ? "" : this.#lostWords());
      return;
    }
    const voices = [["planner", "Planner"], ["bridge", "Bridge"]];
    const problems = [];
    for (const [key, name] of voices) {
      const voice = health[key];
      const silent = voice.heard && voice.silent_s > 0;
      const level = !voice.heard ? "off" : silent ? "bad" : LEVELS[voice.level];
      chip(key, live ? level : "off", !voice.heard ? "not heard" : silent ? `silent ${seconds(voice.silent_s)}` : ["ok", "warning", "error", "error"][voice.level], voice.message);
      if (silent) problems.push(`The ${name.toLowerCase()} is silent for ${seconds(voice.silent_s)}: what is shown of it is old.`);
    }
    const connected = [...this.store.uavs.values()].filter((uav) => uav.link === "connected").length;
    const total = this.store.uavs.size;
    chip("links", !live ? "off" : health.lost.length ? "bad" : connected < total ? "warn" : "good", `${connected}/${total}`);
    const { others } = health;
    byId("chip-others").hidden = !others.length;
    chip("others", others.some((other) => other.error) ? "bad" : "warn", String(others.length), others.map((other) => `${other.node} ${other.part}: ${other.message}`).join("\n"));
    if (health.lost.length) problems.push(`Link lost: ${[...health.lost].sort(natural).join(", ")}.`);
    const quiet = Math.max(0, health.last_data ?? 0) + Math.round((Date.now() - this.heardAt) / 1000);
    byId("last-data").textContent = health.last_data === null ? "no data yet" : `last data ${quiet < 2 ? "now" : `${seconds(quiet)} ago`}`;
    banner(live ? problems.join(" ") : this.#lostWords());
    document.body.classList.toggle("stale", !live);
  }

  #lostWords() {
    if (this.state === "token") return "";
    const since = this.heardAt ? ` What you see is ${seconds((Date.now() - this.heardAt) / 1000)} old.` : "";
    return `No connection to the dashboard${this.why ? ` (${this.why})` : ""}; trying again.${since}`;
  }

  #drawPlan() {
    const { plan, devices } = this.store;
    const total = devices.size;
    const number = { served: 0, planned: 0, interrupted: 0, unserved: 0, waiting: 0 };
    for (const [id, device] of devices) number[this.store.service(device, id)] += 1;
    const coming = number.planned + number.interrupted;
    byId("served").textContent = total ? `${number.served} served now${coming ? ` · ${coming} planned` : ""}` : "–";
    byId("average-rate").textContent = plan ? rate(plan.average_rate) : "–";
    byId("average-rate").title = plan?.average_rate_bound ? `no plan with so many UAVs has more than ${rate(plan.average_rate_bound)}` : "";
    const crewed = plan?.cells.filter((cell) => cell.uav) ?? [];
    const there = crewed.filter((cell) => this.store.isServing(cell.uav)).length;
    byId("reached").textContent = plan ? `${there} of ${plan.cells.length}` : "–";
    if (!plan) {
      byId("proof").textContent = "No plan yet";
      byId("plan-reason").textContent = total ? `${count(total, "device")} known; the planner has published no deployment.` : "No device and no plan yet.";
      return;
    }
    byId("proof").textContent = plan.proof;
    byId("proof").dataset.proven = plan.proven;
    const waiting = number.waiting ? ` · ${count(number.waiting, "device")} not in it yet` : "";
    byId("plan-reason").textContent = `Plan ${plan.id} (${plan.scheme}): ${plan.reason || "no reason given"}${waiting}`;
  }

  #drawUnserved() {
    const entries = Object.entries(this.store.plan?.unserved ?? {}).sort(([a], [b]) => natural(a, b));
    const box = byId("unserved");
    box.hidden = !entries.length;
    box.querySelector("summary").textContent = `${count(entries.length, "device")} not served: why`;
    box.querySelector("ul").replaceChildren(...entries.slice(0, 100).map(([id, reason]) => {
      const li = document.createElement("li");
      li.append(Object.assign(document.createElement("b"), { textContent: id }), `: ${reason}`);
      return li;
    }));
  }
}

function chip(name, level, text, title = "") {
  const element = byId(`chip-${name}`);
  if (element.dataset.level !== level) element.dataset.level = level;
  const words = `${name[0].toUpperCase()}${name.slice(1)} ${text}`;
  const span = element.querySelector("span");
  if (span.textContent !== words) span.textContent = words;
  if (element.title !== title) element.title = title;
}

function banner(text) {
  const element = byId("banner");
  if (element.textContent !== text) element.textContent = text;
  element.hidden = !text;
}
