// Numbers and times in words.

export function rate(bitPerS) {
  if (bitPerS === null || bitPerS === undefined) return "–";
  const units = ["", "k", "M", "G", "T"];
  let value = bitPerS;
  let unit = 0;
  while (Math.abs(value) >= 1000 && unit < units.length - 1) {
    value /= 1000;
    unit += 1;
  }
  return `${Number(value.toPrecision(3))} ${units[unit]}bit/s`;
}

export function metres(value) {
  if (value === null || value === undefined) return "–";
  return value < 1000 ? `${value < 10 ? value.toFixed(1) : Math.round(value)} m` : `${(value / 1000).toFixed(2)} km`;
}

export function seconds(value) {
  if (value < 60) return `${Math.round(value)} s`;
  if (value < 3600) return `${Math.floor(value / 60)} min ${Math.round(value % 60)} s`;
  return `${Math.floor(value / 3600)} h ${Math.floor((value % 3600) / 60)} min`;
}

export function percent(share) {
  return share === null || share === undefined ? "–" : `${Math.round(100 * share)} %`;
}

export function clock(unixS) {
  return new Date(1000 * unixS).toLocaleTimeString([], { hour12: false });
}

export function count(number, noun) {
  return `${number} ${noun}${number === 1 ? "" : "s"}`;
}

/** Names of devices in their natural order: d2 before d10. */
export const natural = new Intl.Collator("en", { numeric: true }).compare;
