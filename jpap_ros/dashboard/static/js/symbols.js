// Shapes on the map. What something is shows by shape and by colour, in Okabe and Ito's palette.

const COLOURS = {
  served: "#009e73",
  planned: "#0072b2",
  unserved: "#d55e00",
  interrupted: "#e69f00",
  waiting: "#8a929c",
  uav: "#0072b2",
  taken: "#a8508a",
  lost: "#d55e00",
  ground: "#7b8794",
};

export function device(context, service, x, y, r) {
  context.beginPath();
  context.lineWidth = 1.5;
  context.strokeStyle = "#fff";
  context.fillStyle = COLOURS[service];
  if (service === "served") context.arc(x, y, r, 0, 2 * Math.PI);
  else if (service === "planned") {
    // Half of a disc: half of it is done.
    context.arc(x, y, r, 0, 2 * Math.PI);
    context.fillStyle = "#fff";
    context.fill();
    context.strokeStyle = COLOURS.planned;
    context.stroke();
    context.beginPath();
    context.arc(x, y, r, 0, Math.PI);
    context.fillStyle = COLOURS.planned;
  } else if (service === "waiting") {
    context.rect(x - r + 1, y - r + 1, 2 * r - 2, 2 * r - 2);
    context.fillStyle = "#fff";
    context.strokeStyle = COLOURS.waiting;
    context.lineWidth = 2;
  } else if (service === "interrupted") polygon(context, [[x, y - r - 1], [x + r + 1, y + r], [x - r - 1, y + r]]);
  else polygon(context, [[x, y - r - 3], [x + r + 3, y], [x, y + r + 3], [x - r - 3, y]]);
  context.fill();
  context.stroke();
  if (service !== "unserved") return;
  const arm = r / 2.2;
  context.beginPath();
  context.moveTo(x - arm, y - arm);
  context.lineTo(x + arm, y + arm);
  context.moveTo(x + arm, y - arm);
  context.lineTo(x - arm, y + arm);
  context.stroke();
}

/** What a UAV's symbol says of it: lost, taken, ground or uav. */
export function kindOf(uav) {
  if (uav.link === "lost" || uav.goal === "lost") return "lost";
  if (uav.landed === "on ground" || uav.landed === "undefined" || uav.landed === undefined) return "ground";
  return uav.taken_over ? "taken" : "uav";
}

export function uav(context, kind, x, y, headingDeg, selected) {
  context.save();
  context.translate(x, y);
  if (selected) {
    context.beginPath();
    context.arc(0, 0, 16, 0, 2 * Math.PI);
    context.fillStyle = "rgba(240, 228, 66, 0.55)";
    context.fill();
  }
  context.strokeStyle = "#fff";
  context.lineWidth = 2;
  if (kind === "ground") {
    context.beginPath();
    context.arc(0, 0, 6, 0, 2 * Math.PI);
    context.lineWidth = 5;
    context.stroke();
    context.lineWidth = 2.5;
    context.strokeStyle = COLOURS.ground;
    context.stroke();
    context.restore();
    return;
  }
  if (kind === "taken") {
    context.beginPath();
    context.arc(0, 0, 14, 0, 2 * Math.PI);
    context.strokeStyle = COLOURS.taken;
    context.stroke();
    context.strokeStyle = "#fff";
  }
  context.save();
  context.rotate(((headingDeg ?? 0) * Math.PI) / 180);
  context.beginPath();
  polygon(context, [[0, -11], [8, 9], [0, 5], [-8, 9]]);
  context.fillStyle = COLOURS[kind];
  context.stroke();
  context.fill();
  context.restore();
  if (kind === "lost") {
    context.beginPath();
    for (const [dx, dy] of [[9, 9], [9, -9]]) {
      context.moveTo(-dx, -dy);
      context.lineTo(dx, dy);
    }
    context.lineWidth = 5;
    context.stroke();
    context.lineWidth = 2.5;
    context.strokeStyle = COLOURS.lost;
    context.stroke();
  }
  context.restore();
}

export function goal(context, x, y) {
  context.beginPath();
  context.arc(x, y, 7, 0, 2 * Math.PI);
  context.moveTo(x - 10, y);
  context.lineTo(x + 10, y);
  context.moveTo(x, y - 10);
  context.lineTo(x, y + 10);
  context.strokeStyle = COLOURS.uav;
  context.lineWidth = 1.5;
  context.stroke();
}

export function drawLegend(canvas, ink) {
  const scale = window.devicePixelRatio || 1;
  const [width, height] = [196, 242];
  canvas.width = width * scale;
  canvas.height = height * scale;
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  context.font = "12px system-ui, sans-serif";
  context.textBaseline = "middle";
  const rows = [
    ["Device served", (y) => device(context, "served", 16, y, 6)],
    ["Planned, not there yet", (y) => device(context, "planned", 16, y, 6)],
    ["Interrupted on the way", (y) => device(context, "interrupted", 16, y, 6)],
    ["Not served", (y) => device(context, "unserved", 16, y, 6)],
    ["Waiting for a plan", (y) => device(context, "waiting", 16, y, 6)],
    ["UAV in the air", (y) => uav(context, "uav", 16, y, 0, false)],
    ["On the ground", (y) => uav(context, "ground", 16, y, 0, false)],
    ["Taken over", (y) => uav(context, "taken", 16, y, 0, false)],
    ["Link lost", (y) => uav(context, "lost", 16, y, 0, false)],
    ["Goal and way to it", (y) => {
      goal(context, 11, y);
      context.setLineDash([4, 3]);
      context.beginPath();
      context.moveTo(19, y);
      context.lineTo(34, y);
      context.stroke();
      context.setLineDash([]);
    }],
  ];
  rows.forEach(([text, draw], row) => {
    const y = 14 + 24 * row;
    draw(y);
    context.fillStyle = ink;
    context.fillText(text, 40, y + 1);
  });
}

function polygon(context, corners) {
  corners.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.closePath();
}
