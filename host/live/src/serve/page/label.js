/**
 * The page on which pictures are labelled: shows what `lipstream landmarks --page` proposes, moves points, and says where they belong.
 *
 * @typedef {{clip: string, picture: number, size: [number, number], points: [number, number][], groups: [string, number][], confidence: number}} Proposal
 * @typedef {{labelled: number, pictures: number, unsure: number, lost: number, expected: number | null, labels: string, output: string, done: boolean, proposal: Proposal | null}} State
 */
const SVG = "http://www.w3.org/2000/svg";
/** Radius of a point's mark, and of what can be grasped of it, in pixels of the screen. */
const MARK = 4, REACH = 11;
/** Pixels of the video that an arrow moves a point, alone and with Shift. */
const STEP = 1, FINE = 0.1;

const by = id => document.getElementById(id), view = by("view");
/** @type {State | null} */
let state = null;
/** @type {[number, number][]} */
let points = [];
/** @type {SVGGElement[]} */
let marks = [];
/** @type {{line: SVGPolylineElement, from: number, to: number}[]} */
let contours = [];
let busy = true;

/** @param {string} name @param {Record<string, string | number>} attributes */
function draw(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  return made;
}

/** What a point is called: its run and its number in it. @param {Proposal} proposal @param {number} point */
function nameOf({ groups }, point) {
  let from = 0;
  for (const [name, size] of groups) {
    if (point < from + size) return `${name} ${point - from}`;
    from += size;
  }
  return `point ${point}`;
}

/** Draws the proposal anew, with its points where they were found. */
function show() {
  const proposal = state.proposal;
  marks = [];
  contours = [];
  points = [];
  view.replaceChildren();
  if (!proposal) return;
  const [width, height] = proposal.size;
  // Pixels have their centres at whole numbers, so that the picture begins half a pixel before the first.
  const edge = { x: -0.5, y: -0.5, width, height };
  view.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
  const query = new URLSearchParams({ clip: proposal.clip, picture: String(proposal.picture) });
  view.append(draw("image", { ...edge, href: `picture?${query}`, preserveAspectRatio: "none" }));
  let from = 0;
  for (const [, size] of proposal.groups) {
    const line = draw("polyline", { class: "contour" });
    contours.push({ line, from, to: from + size });
    view.append(line);
    from += size;
  }
  points = proposal.points.map(([x, y]) => [x, y]);
  points.forEach((_, point) => {
    const mark = draw("g", { class: "point", tabindex: 0, role: "img" });
    mark.append(draw("circle", { class: "reach" }), draw("circle", { class: "mark" }));
    mark.addEventListener("focus", () => say(point));
    marks.push(mark);
    view.append(mark);
  });
  points.forEach((_, point) => put(point));
  fit();
}

/** Keeps marks as large on the screen, however large the picture is shown. */
function fit() {
  const scale = view.getScreenCTM()?.a ?? 1;
  for (const mark of marks) {
    mark.children[0].setAttribute("r", String(REACH / scale));
    mark.children[1].setAttribute("r", String(MARK / scale));
  }
}

/** Draws a point where it is now. @param {number} point */
function put(point) {
  const [x, y] = points[point], [foundX, foundY] = state.proposal.points[point], mark = marks[point];
  mark.setAttribute("transform", `translate(${x} ${y})`);
  mark.setAttribute("aria-label", `${nameOf(state.proposal, point)} at ${x.toFixed(1)}, ${y.toFixed(1)}`);
  mark.classList.toggle("moved", x !== foundX || y !== foundY);
  for (const { line, from, to } of contours) {
    if (point >= from && point < to) line.setAttribute("points", points.slice(from, to).map(at => at.join(",")).join(" "));
  }
}

/** @param {number} point */
function say(point) {
  by("place").textContent = marks[point].ariaLabel ?? marks[point].getAttribute("aria-label");
}

/** Moves a point; one that is dragged over the edge of the picture stays at it. @param {number} point @param {number} x @param {number} y */
function move(point, x, y) {
  const [width, height] = state.proposal.size;
  points[point] = [Math.min(Math.max(x, -0.5), width - 0.5), Math.min(Math.max(y, -0.5), height - 0.5)];
  put(point);
  say(point);
}

/** Where a pointer is, in pixels of the video. @param {PointerEvent} event */
function under(event) {
  return new DOMPoint(event.clientX, event.clientY).matrixTransform(view.getScreenCTM().inverse());
}

/** The point that is nearest to a pointer, -1 where none is within reach. @param {PointerEvent} event */
function nearest(event) {
  const at = under(event), far = points.map(([x, y]) => Math.hypot(x - at.x, y - at.y));
  const least = Math.min(...far);
  return least <= REACH / view.getScreenCTM().a ? far.indexOf(least) : -1;
}

/** Drags the nearest point until the pointer lets go: where points are close, the one on top is not the one that is meant. @param {PointerEvent} event */
function grasp(event) {
  const point = busy || event.button !== 0 ? -1 : nearest(event);
  if (point < 0) return;
  event.preventDefault();
  const mark = marks[point], begin = under(event), [x, y] = points[point];
  mark.focus();
  mark.setPointerCapture(event.pointerId);
  // A point does not jump to the pointer that grasped it beside its middle.
  const drag = moved => {
    if (moved.pointerId !== event.pointerId) return;
    const now = under(moved);
    move(point, x + now.x - begin.x, y + now.y - begin.y);
  };
  const release = ended => {
    if (ended.pointerId !== event.pointerId) return;
    mark.removeEventListener("pointermove", drag);
    mark.removeEventListener("pointerup", drag);
    mark.removeEventListener("lostpointercapture", release);
  };
  mark.addEventListener("pointermove", drag);
  // Where it lets go may be further than its last move.
  mark.addEventListener("pointerup", drag);
  mark.addEventListener("lostpointercapture", release);
}

/** Puts all points back to where they were found. */
function reset() {
  if (busy || !state.proposal) return;
  points = state.proposal.points.map(([x, y]) => [x, y]);
  points.forEach((_, point) => put(point));
}

/** @param {string} text @param {string} [kind] */
function banner(text, kind = "") {
  by("banner").textContent = text;
  by("banner").className = `banner ${kind}`;
  by("banner").hidden = !text;
}

/** What is known, in words and numbers. */
function tell() {
  const proposal = state?.proposal, open = !busy && Boolean(state) && !state.done;
  for (const id of ["accept", "skip", "reset"]) by(id).disabled = !open || !proposal;
  by("done").disabled = !open;
  view.classList.toggle("busy", busy || Boolean(state?.done));
  by("state").classList.toggle("good", open);
  if (!state) return;
  by("source").textContent = proposal ? `${proposal.clip}, picture ${proposal.picture}` : "";
  by("caption").textContent = !proposal ? "No picture is left: all are labelled or skipped."
    : proposal.confidence === 0 ? "No face was found here: these are the points of a picture that is near. Skip it if there is none."
    : `Confidence ${proposal.confidence.toFixed(2)}`;
  const numbers = [
    ["Labelled pictures", state.labelled],
    ["Expected error, median, in % of the face's width", state.expected === null ? "unknown" : (100 * state.expected).toFixed(2)],
    ["Pictures", state.pictures], ["of them unsure", state.unsure], ["without a face", state.lost],
    ["Labels are kept in", state.labels], ["All points go to", state.output],
  ];
  by("numbers").replaceChildren(...numbers.flatMap(([name, value]) => {
    const [term, number] = [document.createElement("dt"), document.createElement("dd")];
    term.textContent = String(name);
    number.textContent = String(value);
    return [term, number];
  }));
}

/** Asks the program for something and shows what it answers. @param {string} doing @param {string} path @param {object} [body] */
async function ask(doing, path, body) {
  busy = true;
  by("state").textContent = doing;
  tell();
  try {
    const answer = await fetch(path, body && { method: "POST", body: JSON.stringify(body) });
    if (answer.ok) {
      state = await answer.json();
      banner(state.done ? `Written: ${state.output}. lipstream has ended; this page can be closed.` : "");
      show();
    } else {
      banner(await answer.text(), "error");
    }
    by("state").textContent = state?.done ? "Done" : "Ready";
  } catch {
    banner("lipstream does not answer: what was accepted is kept in its file of labels.", "error");
    by("state").textContent = "Not connected";
  }
  busy = false;
  tell();
}

function which() {
  return { clip: state.proposal.clip, picture: state.proposal.picture };
}

view.addEventListener("pointerdown", grasp);
by("accept").addEventListener("click", () => ask("Learning …", "accept", { ...which(), points }));
by("skip").addEventListener("click", () => ask("Looking …", "skip", which()));
by("reset").addEventListener("click", reset);
by("done").addEventListener("click", () => ask("Writing …", "done", {}));

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.altKey || event.metaKey || busy) return;
  const point = marks.indexOf(/** @type {SVGGElement} */ (document.activeElement)), arrow = ARROWS[event.key];
  if (arrow && point >= 0) {
    const step = event.shiftKey ? FINE : STEP;
    move(point, points[point][0] + step * arrow[0], points[point][1] + step * arrow[1]);
  } else if (event.key === "Enter" && !(event.target instanceof HTMLButtonElement) && !event.repeat) {
    by("accept").click();
  } else if (event.key.toLowerCase() === "s" && !event.repeat) {
    by("skip").click();
  } else if (event.key.toLowerCase() === "r") {
    by("reset").click();
  } else {
    return;
  }
  event.preventDefault();
});
new ResizeObserver(fit).observe(view);

/** For tests and for the console. */
window.lipstream = { state: () => state, points: () => points, busy: () => busy };
ask("Loading …", "state");
