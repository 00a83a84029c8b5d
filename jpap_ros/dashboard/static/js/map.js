// The map: Leaflet pans, zooms and shows tiles; the scene draws the fleet on top.

import { GeodeticFrame, MetricFrame } from "./frame.js";
import { Scene } from "./scene.js";
import { drawLegend } from "./symbols.js";

export class FleetMap {
  /** @param onPick called with ["uav" or "device", name], or null beside everything; @param onPlace with east, north */
  constructor(store, page, onPick, onPlace) {
    const tiles = Boolean(page.tile_url);
    this.store = store;
    this.frame = tiles ? new GeodeticFrame(page.origin) : new MetricFrame();
    this.map = L.map("map", {
      crs: tiles ? L.CRS.EPSG3857 : L.CRS.Simple,
      center: this.frame.toLatLng(0, 0),
      zoom: tiles ? 15 : 0,
      minZoom: tiles ? 2 : -8,
      maxZoom: tiles ? 22 : 6,
      zoomSnap: 0.25,
      zoomDelta: 0.5,
      wheelPxPerZoomLevel: 100,
      // The scene follows every step of a move by itself.
      zoomAnimation: false,
      fadeAnimation: false,
      attributionControl: tiles,
    });
    if (tiles) {
      this.map.attributionControl.setPrefix("");
      const attribution = document.createElement("span");
      attribution.textContent = page.tile_attribution;
      L.tileLayer(page.tile_url, { maxZoom: 22, maxNativeZoom: 19, attribution: attribution.innerHTML }).addTo(this.map);
    }
    L.control.scale({ imperial: false, position: "bottomright" }).addTo(this.map);
    this.scene = new Scene(this.map, this.frame, store);
    this.placing = false;
    // Until somebody moves the map, it shows everything, also after the window was turned or resized.
    this.own = true;
    for (const gesture of ["pointerdown", "wheel", "keydown"]) {
      this.map.getContainer().addEventListener(gesture, () => {
        this.own = false;
      }, { passive: true });
    }
    this.map.on("resize", () => this.own && this.fit());
    this.map.on("click", (event) => {
      if (this.placing) onPlace(...this.frame.toMap(event.latlng));
      else onPick(this.scene.hit(event.containerPoint));
    });
    this.map.on("mousemove", (event) => {
      const over = this.placing || this.scene.hit(event.containerPoint);
      this.map.getContainer().classList.toggle("over", Boolean(over));
    });
    document.getElementById("fit").onclick = () => this.fit();
    for (const box of document.querySelectorAll("[data-layer]")) {
      box.onchange = () => {
        this.scene.layers[box.dataset.layer] = box.checked;
        this.scene.redraw();
      };
    }
    const legend = document.getElementById("legend");
    if (matchMedia("(max-width: 900px), (max-height: 700px)").matches) legend.open = false;
    const canvas = document.getElementById("legend-canvas");
    const ink = () => drawLegend(canvas, getComputedStyle(document.body).color);
    ink();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      ink();
      this.scene.redraw();
    });
  }

  update(changed) {
    this.scene.update(changed);
    if (this.own && (changed.all || changed.plan || changed.devices.length)) this.fit();
  }

  fit() {
    this.own = true;
    const bounds = this.scene.bounds();
    if (bounds) this.map.fitBounds(bounds, { padding: [40, 40], maxZoom: this.store.page.tile_url ? 18 : 2, animate: false });
  }

  show(east, north) {
    const place = this.frame.toLatLng(east, north);
    if (!this.map.getBounds().pad(-0.1).contains(place)) this.map.panTo(place, { animate: false });
  }

  select(names) {
    this.scene.selected = names;
    this.scene.redraw();
  }

  pick(device) {
    this.scene.picked = device;
    this.scene.redraw();
  }

  place(on) {
    this.placing = on;
    this.map.getContainer().classList.toggle("placing", on);
  }
}
