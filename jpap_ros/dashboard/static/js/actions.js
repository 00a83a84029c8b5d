// The operator's orders: for the aircraft selected, or for all; each is asked once more.

import { confirm, toast } from "./dialogs.js";
import { count, natural } from "./format.js";

const WORDS = {
  launch: ["Launch", "They arm, take off and fly to the planner's goals. One in the air that was taken over is taken back."],
  hold: ["Hold", "They stay where they are until they are launched again."],
  return_home: ["Return", "They fly home and land there."],
  land: ["Land", "They land where they are now. Is the ground below them free?"],
  give_back: ["Give back", "Aircraft that a pilot, a ground station or a failsafe took over fly the planner's goals again. Has the pilot let go?"],
};

export class Actions {
  constructor(store, connection, onSelect) {
    this.store = store;
    this.connection = connection;
    this.onSelect = onSelect;
    this.selected = new Set();
    for (const button of document.querySelectorAll("[data-action]")) button.onclick = () => this.ask(button.dataset.action);
  }

  /** Select exactly these aircraft; none means that actions are for all. */
  select(names) {
    this.selected = new Set(names);
    this.update();
    this.onSelect(this.selected);
  }

  toggle(name) {
    const names = new Set(this.selected);
    if (!names.delete(name)) names.add(name);
    this.select(names);
  }

  update() {
    const yielded = this.#targets("give_back").length;
    const words = this.selected.size ? `${count(this.selected.size, "aircraft").replace("crafts", "craft")} selected` : `All ${this.store.uavs.size} aircraft`;
    document.getElementById("selection").textContent = words;
    const giveBack = document.querySelector('[data-action="give_back"]');
    giveBack.disabled = !yielded;
    giveBack.textContent = yielded ? `Give back (${yielded})` : "Give back";
  }

  async ask(action) {
    if (document.querySelector("dialog[open]")) return;
    if (!this.connection.live) {
      toast("No connection to the dashboard: nothing can be ordered.", false);
      return;
    }
    if (action === "replan") {
      const sure = await confirm({ title: "Replan now?", text: "The planner makes a plan for the devices and aircraft as they are. Aircraft may move.", yes: "Replan" });
      if (sure) this.#report("Replan", await this.connection.ask("replan"));
      return;
    }
    const uavs = this.#targets(action);
    const [verb, text] = WORDS[action];
    if (!uavs.length) {
      toast(action === "give_back" ? "No aircraft was taken over." : "No aircraft is known yet.", false);
      return;
    }
    // Nothing selected may be an oversight.
    const everybody = !this.selected.size && uavs.length > 1;
    const sure = await confirm({
      title: `${verb} ${uavs.length === 1 ? uavs[0] : `${everybody ? "ALL " : ""}${uavs.length} aircraft`}?`,
      text,
      names: uavs.length > 1 ? uavs.join(", ") : "",
      yes: verb,
      danger: action === "land",
      grave: action === "land" || everybody,
    });
    if (!sure) return;
    this.#report(verb, await this.connection.ask(action, { uavs }));
  }

  #targets(action) {
    const names = [...(this.selected.size ? this.selected : this.store.uavs.keys())].sort(natural);
    return action === "give_back" ? names.filter((name) => this.store.uavs.get(name)?.taken_over) : names;
  }

  #report(verb, answer) {
    toast(`${verb}: ${answer.message}`, answer.ok);
  }
}
