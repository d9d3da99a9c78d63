/**
 * Looks back over the last seconds: small copies of the images that this page has shown, in this
 * browser's memory only (25 moments, about 3 MB).
 *
 * @import {Role, Session} from "./types.js"
 * @import {Tile} from "./images.js"
 */
import { byId, make, say } from "./dom.js";

const INTERVAL_MS = 200;
/** Number of moments: five seconds. */
const KEPT = 25;
const QUALITY = 0.8;

/** Images of one moment. @typedef {{at: number, images: Map<Role, Blob>}} Moment */

/** Oldest first. @type {Moment[]} */
let moments = [];
/** When the slider left the live end; null while live. Nothing is added meanwhile. @type {number|null} */
let stoppedAt = null;
/** State of the session when the slider left the live end. */
let stoppedIn = "";
let sessionNow = "";
/** @type {() => Iterable<Tile>} */
let tiles = () => [];
const canvas = make("canvas");

/** Adds the images that are visible now. */
async function record() {
  if (stoppedAt !== null || document.hidden) return;
  const at = performance.now();
  /** @type {Map<Role, Blob>} */
  const images = new Map();
  for (const { role, image, figure } of tiles()) {
    if (figure.matches(".failed, .waiting") || !image.complete || !image.naturalWidth) continue;
    const blob = await copy(image);
    if (blob) images.set(role, blob);
  }
  if (images.size && stoppedAt === null) moments = [...moments, { at, images }].slice(-KEPT);
}

/** @param {HTMLImageElement} image @returns {Promise<Blob|null>} */
function copy(image) {
  canvas.width = image.naturalWidth;
  canvas.height = image.naturalHeight;
  canvas.getContext("2d").drawImage(image, 0, 0);
  return new Promise((resolve) => canvas.toBlob(resolve, "image/jpeg", QUALITY));
}

/** Shows the moment that the slider chooses. */
function show() {
  const back = -Number(byId("moment").value);
  const moment = back > 0 ? moments.at(-Math.min(back, moments.length)) : undefined;
  if (!moment) return goLive();
  if (stoppedAt === null) {
    stoppedAt = performance.now();
    stoppedIn = sessionNow;
  }
  byId("images").classList.add("past");
  say(byId("moment-words"), `${((stoppedAt - moment.at) / 1000).toFixed(1)} s back`);
  for (const { role, past } of tiles()) {
    URL.revokeObjectURL(past.src);
    const blob = moment.images.get(role);
    if (blob) past.src = URL.createObjectURL(blob);
    else past.removeAttribute("src");
  }
}

/** Returns to the live images. */
export function goLive() {
  byId("moment").value = "0";
  say(byId("moment-words"), "live");
  if (stoppedAt === null) return;
  stoppedAt = null;
  moments = [];
  byId("images").classList.remove("past");
  for (const { past } of tiles()) {
    URL.revokeObjectURL(past.src);
    past.removeAttribute("src");
  }
}

/** Every step of the session returns to the live images. @param {Session} session */
export function drawRecent({ step, initial_at, last, refusal }) {
  sessionNow = JSON.stringify([step, initial_at, last?.id, refusal]);
  if (stoppedAt !== null && sessionNow !== stoppedIn) goLive();
}

/** @param {() => Iterable<Tile>} source the tiles of the cameras */
export function startRecent(source) {
  tiles = source;
  const slider = byId("moment");
  slider.min = String(1 - KEPT);
  slider.addEventListener("input", show);
  // The pedal's space must not stay with the slider.
  slider.addEventListener("pointerup", () => slider.blur());
  setInterval(record, INTERVAL_MS);
}
