/**
 * Health of the cameras in detail, and the fault panel.
 *
 * @import {Camera, Role, State} from "./types.js"
 */
import { button, byId, make, refill, style } from "./dom.js";
import { consequence, fault, identity, isFault, liveCount, rates, stateWords } from "./words.js";

/** Minimised faults; a camera that recovers is removed. @type {Set<Role>} */
const minimised = new Set();
/** @type {State|null} */
let latest = null;

/** @param {State} state */
export function drawCameras(state) {
  latest = state;
  drawDetail(state.cameras);
  drawFault();
}

/** Minimises the current faults to one line. */
export function minimiseFaults() {
  for (const camera of latest?.cameras.filter(isFault) ?? []) minimised.add(camera.role);
  drawFault();
}

function drawFault() {
  if (!latest) return;
  const { cameras, session } = latest;
  const failed = cameras.filter(isFault);
  for (const role of [...minimised]) {
    if (!failed.some((camera) => camera.role === role)) minimised.delete(role);
  }
  const large = failed.some(({ role }) => !minimised.has(role));
  const box = byId("fault");
  box.hidden = failed.length === 0;
  byId("work").classList.toggle("behind", large);
  style(box, large ? "large" : "");
  const reassurance =
    session.step === "label"
      ? "the last grasp is saved; label it: s stable, f slip"
      : "all saved grasps are safe; this panel closes by itself";
  // Screen readers must not read out the counting seconds.
  const key = [large, reassurance, failed.map(({ role, state, reason, port, serial }) => [role, state, reason, port, serial])];
  refill(box, key, () => (large ? largeFault(failed, cameras, reassurance) : failed.map(smallFault)));
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

/** @param {Camera[]} failed @param {Camera[]} all @param {string} reassurance */
function largeFault(failed, all, reassurance) {
  const [first, ...others] = failed;
  if (!first) return [];
  const { part, remedy } = fault(first);
  const nodes = [
    make("h2", "", `${part} `, since(first)),
    make("p", "where", identity(first)),
    make("p", "remedy", `→ ${remedy}`),
  ];
  if (first.reason) nodes.push(make("p", "reason", first.reason));
  for (const other of others) {
    nodes.push(make("p", "also", `also: ${fault(other).part} `, since(other), ` — ${fault(other).remedy} (${identity(other)})`));
  }
  nodes.push(make("p", "", `${liveCount(all)} · ${consequence(failed)}`), make("p", "", reassurance));
  nodes.push(button("minimise (Esc)", minimiseFaults));
  return nodes;
}

/** @param {Camera} camera */
function smallFault(camera) {
  const { part, remedy } = fault(camera);
  return make("p", "", make("b", "", `${part} `, since(camera)), ` — ${remedy} (${identity(camera)})`);
}

/** @param {Camera} camera */
function tone(camera) {
  if (camera.state === "live") return "stable";
  return camera.state === "no_valid_depth" ? "warning" : "slip";
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
        make("h3", "", `${camera.role} `, make("span", tone(camera), words)),
        make("p", "", identity(camera)),
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
