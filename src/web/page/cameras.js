/**
 * Health of the cameras in detail, and a failed one in red.
 *
 * @import {Camera, Role, State} from "./types.js"
 */
import { button, byId, make, refill, style } from "./dom.js";
import { alive, fault, isFault, place, rates, stateWords } from "./words.js";

/** Faults that were made small by hand; a camera that is back may fail loudly again. @type {Set<Role>} */
const shrunk = new Set();
/** @type {State|null} */
let latest = null;

/** @param {State} state */
export function drawCameras(state) {
  latest = state;
  drawDetail(state.cameras);
  drawFault();
}

/** Makes the present faults one line. */
export function shrinkFaults() {
  for (const camera of latest?.cameras.filter(isFault) ?? []) shrunk.add(camera.role);
  drawFault();
}

function drawFault() {
  if (!latest) return;
  const { cameras, session } = latest;
  const failed = cameras.filter(isFault);
  for (const role of [...shrunk]) {
    if (!failed.some((camera) => camera.role === role)) shrunk.delete(role);
  }
  const large = failed.some(({ role }) => !shrunk.has(role));
  const box = byId("fault");
  box.hidden = failed.length === 0;
  byId("work").classList.toggle("behind", large);
  style(box, large ? "large" : "");
  const calm =
    session.step === "label"
      ? "the last grasp is saved; label it: s stable, f slip"
      : "all saved grasps are safe; this closes by itself";
  // Seconds that count up must not be read out again and again.
  const key = [large, calm, failed.map(({ role, state, reason, port, serial }) => [role, state, reason, port, serial])];
  refill(box, key, () => (large ? largeFault(failed, cameras, calm) : failed.map(smallFault)));
  for (const camera of failed) {
    const since = box.querySelector(`[data-role="${camera.role}"]`);
    if (since) since.textContent = fault(camera).words;
  }
}

/** @param {Camera} camera */
function since(camera) {
  const node = make("span", "", fault(camera).words);
  node.dataset.role = camera.role;
  node.setAttribute("aria-live", "off");
  return node;
}

/** @param {Camera[]} failed @param {Camera[]} all @param {string} calm */
function largeFault(failed, all, calm) {
  const [first, ...others] = failed;
  if (!first) return [];
  const { part, remedy } = fault(first);
  const nodes = [
    make("h2", "", `${part} `, since(first)),
    make("p", "where", place(first)),
    make("p", "remedy", `→ ${remedy}`),
  ];
  if (first.reason) nodes.push(make("p", "reason", first.reason));
  for (const other of others) {
    nodes.push(make("p", "also", `also: ${fault(other).part} `, since(other), ` — ${fault(other).remedy} (${place(other)})`));
  }
  nodes.push(make("p", "", `${alive(all)} · capture is blocked until it is back`), make("p", "", calm));
  nodes.push(button("make it small (Esc)", shrinkFaults));
  return nodes;
}

/** @param {Camera} camera */
function smallFault(camera) {
  const { part, remedy } = fault(camera);
  return make("p", "", make("b", "", `${part} `, since(camera)), ` — ${remedy} (${place(camera)})`);
}

/** @param {Camera[]} cameras */
function drawDetail(cameras) {
  if (!byId("sensors-dialog").open) return;
  refill(byId("sensors-detail"), cameras, () =>
    cameras.map((camera) => {
      const { rate, age } = rates(camera);
      const words = `${stateWords(camera)}${camera.reason ? `: ${camera.reason}` : ""}`;
      const counters = [
        `${camera.received} received`,
        `${camera.sequence_gaps} lost`,
        `${camera.damaged} damaged`,
        `${camera.late} late`,
        `${camera.reconnects} reopened`,
      ];
      return make(
        "section",
        "",
        make("h3", "", `${camera.role} `, make("span", camera.state === "live" ? "stable" : "slip", words)),
        make("p", "", place(camera)),
        make("p", "", `${rate} · newest frame ${age} old`),
        make("p", "faint", counters.join(" · ")),
        ...(camera.markers ? [make("p", camera.markers.ok ? "stable" : "warning", camera.markers.text)] : []),
      );
    }),
  );
}

export function openSensors() {
  byId("sensors-dialog").showModal();
  if (latest) drawDetail(latest.cameras);
}
