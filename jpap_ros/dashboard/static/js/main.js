// Puts the page together.

import { Actions } from "./actions.js";
import { Connection } from "./connection.js";
import { Details } from "./details.js";
import { askToken } from "./dialogs.js";
import { Exercise } from "./exercise.js";
import { listen, Tabs } from "./keys.js";
import { FleetMap } from "./map.js";
import { StatusPanel } from "./status.js";
import { Store } from "./store.js";
import { AircraftTable, DeviceTable, EventList } from "./tables.js";

const store = new Store();
const status = new StatusPanel(store);
const connection = new Connection(take, onState);
const actions = new Actions(store, connection, onSelect);
const aircraft = new AircraftTable(store, actions, (name) => show("uav", name));
const devices = new DeviceTable(store, (id) => show("device", id));
const events = new EventList(store);
const details = new Details(store, () => pick(null));
const exercise = new Exercise(store, connection, (on) => map?.place(on));
const tabs = new Tabs(() => {
  devices.draw();
  events.update({ events: 0 });
});
let map;

function take(message) {
  const changed = store.apply(message);
  map ??= new FleetMap(store, store.page, onMapPick, (east, north) => exercise.place(east, north));
  document.getElementById("tab-exercise").hidden = !store.page.exercise;
  for (const part of [status, map, aircraft, devices, events, details]) part.update(changed);
  if (changed.all) actions.select([...actions.selected].filter((name) => store.uavs.has(name)));
  else if (changed.goals) actions.update();
}

function onState(state, why) {
  status.connection(state, why);
  if (state === "token") askToken(why, (token) => connection.useToken(token));
}

function onSelect(names) {
  aircraft.select(names);
  map?.select(names);
}

function onMapPick(picked) {
  if (picked?.[0] === "uav") actions.toggle(picked[1]);
  pick(picked);
}

function pick(picked) {
  details.show(picked);
  map?.pick(picked?.[0] === "device" ? picked[1] : null);
  if (picked?.[0] === "device") exercise.edit(picked[1]);
}

function show(kind, name) {
  const item = (kind === "uav" ? store.uavs : store.devices).get(name);
  if (item?.x !== undefined) map.show(item.x, item.y);
  pick([kind, name]);
}

listen({
  actions,
  store,
  map: () => map,
  tabs,
  clear() {
    exercise.placing(false);
    pick(null);
    actions.select([]);
  },
});
connection.connect();
