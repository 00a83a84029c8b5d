// Exercise: devices put, changed and removed by hand.

import { confirm, toast } from "./dialogs.js";

const FIELDS = ["x", "y", "demand", "weight"];

export class Exercise {
  constructor(store, connection, onPlacing) {
    this.store = store;
    this.connection = connection;
    this.onPlacing = onPlacing;
    this.form = document.getElementById("exercise");
    this.pickButton = document.getElementById("pick");
    this.form.onsubmit = (event) => {
      event.preventDefault();
      this.#put();
    };
    this.pickButton.onclick = () => this.placing(this.pickButton.getAttribute("aria-pressed") !== "true");
    document.getElementById("remove").onclick = () => this.#remove();
  }

  /** Fill in a device that was clicked. */
  edit(id) {
    const device = this.store.devices.get(id);
    if (!device) return;
    this.form.elements.id.value = id;
    for (const field of FIELDS) this.form.elements[field].value = device[field];
  }

  placing(on) {
    this.pickButton.setAttribute("aria-pressed", String(on));
    this.onPlacing(on);
  }

  place(east, north) {
    this.form.elements.x.value = east.toFixed(1);
    this.form.elements.y.value = north.toFixed(1);
    this.placing(false);
    if (!this.form.elements.id.value) this.form.elements.id.value = this.#freeId();
    this.form.querySelector('[type="submit"]').focus();
  }

  #freeId() {
    let number = 1;
    while (this.store.devices.has(`exercise${number}`)) number += 1;
    return `exercise${number}`;
  }

  async #put() {
    const device = { id: this.form.elements.id.value.trim() };
    for (const field of FIELDS) {
      // Number("") is 0: a field left empty must not become one.
      const text = this.form.elements[field].value.trim().replace(",", ".");
      device[field] = text === "" ? null : Number(text);
    }
    const answer = await this.connection.ask("put_device", { device });
    toast(answer.ok ? `Device ${device.id} reported.` : answer.message, answer.ok);
    if (answer.ok) this.form.elements.id.value = "";
  }

  async #remove() {
    const id = this.form.elements.id.value.trim();
    if (!this.store.devices.has(id)) {
      toast(id ? `Device ${id} is not there.` : "Choose a device: click it on the map, or enter its id.", false);
      return;
    }
    const sure = await confirm({ title: `Remove device ${id}?`, text: "It is reported as departed, and the planner plans without it.", yes: "Remove", danger: true });
    if (!sure) return;
    const answer = await this.connection.ask("remove_device", { device: id });
    toast(answer.ok ? `Device ${id} removed.` : answer.message, answer.ok);
  }
}
