// Places: from metres of the map frame to what Leaflet takes, and back.

// WGS-84
const SEMI_MAJOR_M = 6378137;
const E2 = 0.00669437999014;

/** The map in metres: "latitude" is north, "longitude" east. */
export class MetricFrame {
  toLatLng(east, north) {
    return L.latLng(north, east);
  }

  toMap(latLng) {
    return [latLng.lng, latLng.lat];
  }
}

/** The plane tangent to the ellipsoid at an origin, as the rest of jpap_ros has it. */
export class GeodeticFrame {
  constructor([latitude, longitude]) {
    this.origin = { lat: latitude, lng: longitude };
    this.center = cartesian(latitude, longitude);
    const root = Math.sqrt(1 - E2 * Math.sin(radians(latitude)) ** 2);
    this.perNorth = degrees((root ** 3) / (SEMI_MAJOR_M * (1 - E2)));
    this.perEast = degrees(root / (SEMI_MAJOR_M * Math.cos(radians(latitude))));
  }

  toMap(latLng) {
    const [x, y, z] = cartesian(latLng.lat, latLng.lng).map((value, axis) => value - this.center[axis]);
    const [lat, lng] = [radians(this.origin.lat), radians(this.origin.lng)];
    const outward = Math.cos(lng) * x + Math.sin(lng) * y;
    return [Math.cos(lng) * y - Math.sin(lng) * x, Math.cos(lat) * z - Math.sin(lat) * outward];
  }

  toLatLng(east, north) {
    // Newton's method with the derivative at the origin.
    const found = { ...this.origin };
    let [missingEast, missingNorth] = [east, north];
    for (let step = 0; step < 20 && Math.hypot(missingEast, missingNorth) > 1e-6; step += 1) {
      found.lat += missingNorth * this.perNorth;
      found.lng += missingEast * this.perEast;
      const [hereEast, hereNorth] = this.toMap(found);
      [missingEast, missingNorth] = [east - hereEast, north - hereNorth];
    }
    return L.latLng(found.lat, found.lng);
  }
}

function cartesian(latitude, longitude) {
  const [lat, lng] = [radians(latitude), radians(longitude)];
  const vertical = SEMI_MAJOR_M / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
  const flat = vertical * Math.cos(lat);
  return [flat * Math.cos(lng), flat * Math.sin(lng), vertical * (1 - E2) * Math.sin(lat)];
}

const radians = (value) => (value * Math.PI) / 180;
const degrees = (value) => (value * 180) / Math.PI;
