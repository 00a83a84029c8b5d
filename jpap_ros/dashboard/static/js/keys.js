// Single keys as shortcuts. They can be switched off: voice control may type them by chance.

const ORDERS = { l: "launch", h: "hold", r: "return_home", d: "land", g: "give_back", p: "replan" };
const STORED = "jpap_keys";

export function listen({ actions, store, map, tabs, clear }) {
  const help = document.getElementById("help");
  const box = document.getElementById("keys-on");
  box.checked = localStorage.getItem(STORED) !== "off";
  box.onchange = () => localStorage.setItem(STORED, box.checked ? "on" : "off");
  document.getElementById("help-button").onclick = () => help.showModal();
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || document.querySelector("dialog[open]")) return;
    const typing = event.target.closest("input:not([type=checkbox]), textarea, select");
    if (event.key === "Escape") {
      if (typing) event.target.blur();
      else clear();
      return;
    }
    if (typing || !box.checked) return;
    const key = event.key.toLowerCase();
    if (ORDERS[key]) actions.ask(ORDERS[key]);
    else if (key === "a") actions.select(actions.selected.size === store.uavs.size ? [] : store.uavs.keys());
    else if (key === "f") map()?.fit();
    else if (key === "?") help.showModal();
    else if (/^[1-4]$/.test(key)) tabs.open(Number(key) - 1);
    else return;
    event.preventDefault();
  });
}

/** The tabs, by click and by arrow keys. */
export class Tabs {
  constructor(onOpen) {
    this.onOpen = onOpen;
    this.tabs = [...document.querySelectorAll('[role="tab"]')];
    this.tabs.forEach((tab, i) => {
      tab.onclick = () => this.open(i);
      tab.onkeydown = (event) => {
        const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
        if (!step) return;
        const shown = this.tabs.filter((other) => !other.hidden);
        const next = shown[(shown.indexOf(tab) + step + shown.length) % shown.length];
        this.open(this.tabs.indexOf(next));
        next.focus();
      };
    });
  }

  open(index) {
    if (this.tabs[index].hidden) return;
    this.tabs.forEach((tab, i) => {
      tab.setAttribute("aria-selected", String(i === index));
      tab.tabIndex = i === index ? 0 : -1;
      document.getElementById(tab.getAttribute("aria-controls")).hidden = i !== index;
    });
    this.onOpen();
  }
}
