/**
 * Live images with the health of each camera. Browsers open at most six connections to a server
 * over all windows, and streams in two windows would leave none for commands. So one window
 * streams; all others fetch single images over at most two connections.
 *
 * @import {Camera, Role, State} from "./types.js"
 */
import { address } from "./api.js";
import { openSensors } from "./cameras.js";
import { button, byId, make, refill, say, style } from "./dom.js";
import { deliversFrames, forceWords, isFault, rates, shearWords, stateWords, problems } from "./words.js";

const STILL_FETCHERS = 2;
/** Minimum interval between two images of a camera; the server makes ten per second, ms. */
const STILL_INTERVAL_MS = 100;
const RETRY_MS = 2000;
const LOCK = "gripcast-streams";
/** What is shown of a gel; a tap on its image changes it. @type {Record<string, string>} */
const GEL_VIEWS = { both: "raw image and difference", difference: "difference", raw: "raw image" };
const GEL_VIEW = "gripcast-gels";

/**
 * @typedef {object} Tile
 * @property {Role} role
 * @property {any} figure
 * @property {HTMLImageElement} image
 * @property {HTMLImageElement} past the image of an earlier moment, over the live one
 * @property {HTMLElement} health
 * @property {HTMLElement} cover
 * @property {string} state
 * @property {number} due earliest time of the next request, ms
 * @property {boolean} busy
 */

export class Images {
  constructor() {
    /** @type {Map<Role, Tile>} */
    this.tiles = new Map();
    this.running = false;
    this.streaming = false;
    /** Number of starts and stops; work of an earlier round ends by itself. */
    this.round = 0;
    /** @type {(() => void)|null} */
    this.release = null;
    // A click must not move the focus, or the next space would press the image again.
    byId("images").addEventListener("mousedown", (/** @type {MouseEvent} */ event) => event.preventDefault());
  }

  /** @param {State} state */
  draw(state) {
    const roles = state.cameras.map(({ role }) => role);
    if (roles.join() !== [...this.tiles.keys()].join()) this.createTiles(roles);
    for (const camera of state.cameras) this.caption(camera, state);
  }

  /** @param {Role[]} roles */
  createTiles(roles) {
    const box = byId("images");
    this.tiles = new Map(roles.map((role) => [role, tile(role)]));
    box.replaceChildren(...[...this.tiles.values()].map(({ figure }) => figure));
    box.style.setProperty("--columns", roles.map((role) => (isGel(role) ? "var(--gel)" : "minmax(0, 1fr)")).join(" "));
    box.dataset.others = String(roles.filter((role) => !isGel(role)).length);
    showGels(gelView);
    if (this.running) this.start();
  }

  /** @param {Camera} camera @param {State} state */
  caption(camera, { contact, force, gels, shear }) {
    const tile = this.tiles.get(camera.role);
    if (!tile) return;
    const touch = isGel(camera.role) ? contact?.[/** @type {"left"|"right"} */ (camera.role)] : null;
    const messages = (isGel(camera.role) && gels?.[/** @type {"left"|"right"} */ (camera.role)]?.messages) || [];
    const moved = isGel(camera.role) ? shear?.[/** @type {"left"|"right"} */ (camera.role)] : undefined;
    const pressed = isGel(camera.role) ? force?.[/** @type {"left"|"right"} */ (camera.role)] : undefined;
    const words = [typeof touch === "number" ? `contact ${touch.toFixed(1)}` : "", forceWords(pressed), shearWords(moved)].filter(Boolean).join(" · ");
    const all = [...messages, ...(moved?.messages ?? [])];
    refill(tile.health, [camera, words, all], () => health(camera, words, all));
    const delivers = deliversFrames(camera);
    const state = isFault(camera) ? "failed" : delivers ? "" : "waiting";
    style(tile.figure, `${isGel(camera.role) ? "gel " : ""}${state}`.trim());
    say(tile.cover, delivers ? "" : stateWords(camera));
    const back = delivers && tile.state === "gone";
    tile.state = delivers ? "delivers" : "gone";
    if (back && this.streaming) this.stream(tile);
  }

  /** Starts or restarts loading. */
  start() {
    this.stop();
    this.running = true;
    const round = this.round;
    for (let i = 0; i < STILL_FETCHERS; i += 1) this.fetchStills(round);
    // Locks need a secure context; without them single images are fetched.
    navigator.locks?.request(LOCK, () => this.holdStreams(round));
  }

  stop() {
    this.round += 1;
    this.running = false;
    this.release?.();
    for (const tile of this.tiles.values()) {
      tile.busy = false;
      if (this.streaming) tile.image.removeAttribute("src");
    }
    this.streaming = false;
  }

  /** Streams while this round lasts. @param {number} round @returns {Promise<void>|undefined} */
  holdStreams(round) {
    if (round !== this.round) return undefined;
    this.streaming = true;
    for (const tile of this.tiles.values()) this.stream(tile);
    return new Promise((resolve) => {
      this.release = resolve;
    });
  }

  /** @param {Tile} tile */
  stream(tile) {
    const round = this.round;
    tile.image.onerror = () => {
      setTimeout(() => {
        if (round === this.round && tile.state === "delivers") this.stream(tile);
      }, RETRY_MS);
    };
    tile.image.src = address(`api/cameras/${tile.role}/preview.mjpg?image=both&start=${Date.now()}`);
  }

  /** @param {number} round */
  async fetchStills(round) {
    while (round === this.round && !this.streaming) {
      const now = performance.now();
      const waiting = [...this.tiles.values()].filter((tile) => !tile.busy);
      const tile = waiting.sort((a, b) => a.due - b.due)[0];
      if (!tile || tile.due > now) {
        const pause = tile ? tile.due - now : STILL_INTERVAL_MS;
        await new Promise((resolve) => setTimeout(resolve, pause));
        continue;
      }
      tile.busy = true;
      tile.due = now + ((await this.still(tile, round)) ? STILL_INTERVAL_MS : RETRY_MS);
      if (round === this.round) tile.busy = false;
    }
  }

  /** Fetches one image; false on failure. @param {Tile} tile @param {number} round */
  async still(tile, round) {
    try {
      const response = await fetch(address(`api/cameras/${tile.role}/preview.jpg?image=both`), {
        cache: "no-store",
        signal: AbortSignal.timeout(5000),
      });
      if (!response.ok) return false;
      const url = URL.createObjectURL(await response.blob());
      tile.image.onload = tile.image.onerror = () => URL.revokeObjectURL(url);
      if (round === this.round && !this.streaming) tile.image.src = url;
      else URL.revokeObjectURL(url);
      return true;
    } catch {
      return false;
    }
  }
}

/** @param {Role} role */
function isGel(role) {
  return role === "left" || role === "right";
}

/** Raw image and difference arrive as one image, side by side. @param {Node[]} children */
function gelFrame(...children) {
  const frame = button("", nextGelView, "frame");
  frame.append(...children, make("span", "half raw", "raw"), make("span", "half difference", "difference"));
  return frame;
}

/** @param {Node[]} children */
function sensorFrame(...children) {
  const frame = button("", openSensors, "frame");
  frame.append(...children);
  frame.title = "sensors in detail (h)";
  return frame;
}

/** Key of `GEL_VIEWS`, as chosen in this browser. */
let gelView = "both";
try {
  const chosen = localStorage.getItem(GEL_VIEW) ?? "";
  if (chosen in GEL_VIEWS) gelView = chosen;
} catch {
  // Without storage the choice ends with the page.
}

function nextGelView() {
  const views = Object.keys(GEL_VIEWS);
  showGels(views[(views.indexOf(gelView) + 1) % views.length] ?? "both");
  try {
    localStorage.setItem(GEL_VIEW, gelView);
  } catch {
    // As above.
  }
}

/** @param {string} view */
function showGels(view) {
  gelView = view;
  const box = byId("images");
  box.dataset.gels = view;
  for (const frame of box.querySelectorAll(".gel button.frame")) {
    frame.setAttribute("aria-label", `${GEL_VIEWS[view]}; press to change what is shown of the gels`);
  }
}

/** @param {Role} role @returns {Tile} */
function tile(role) {
  const image = make("img");
  image.alt = isGel(role) ? `${role} gel, raw image and difference to the initial frame` : `${role} camera`;
  image.dataset.role = role;
  const name = make("b", "", role);
  const past = make("img", "earlier");
  past.alt = "";
  const words = make("span", "health");
  const caption = make("figcaption", "", name, words);
  const cover = make("span", "cover");
  const frame = isGel(role) ? gelFrame(image, past, cover) : sensorFrame(image, past, cover);
  const figure = make("figure", isGel(role) ? "gel" : "", caption, frame);
  figure.dataset.role = role;
  return { role, figure, image, past, health: words, cover, state: "", due: 0, busy: false };
}

/** Frame rate, age, contact and problems. @param {Camera} camera @param {string} contact
 * @param {string[]} messages problems of a gel's image */
function health(camera, contact, messages) {
  const nodes = [];
  if (camera.state === "live") {
    const { rate, slow, age, old } = rates(camera);
    nodes.push(make("span", slow ? "warning" : "", rate), make("span", old ? "warning" : "faint", age));
  } else {
    nodes.push(make("span", isFault(camera) ? "slip" : deliversFrames(camera) ? "warning" : "faint", stateWords(camera)));
  }
  if (contact) nodes.push(make("span", "faint", contact));
  const warning = problems(camera);
  if (warning) nodes.push(make("span", "warning", warning));
  else if (camera.markers) nodes.push(make("span", "stable", camera.markers.text));
  for (const message of messages) nodes.push(make("span", "warning", message));
  if (camera.reason) nodes.push(make("span", "slip", camera.reason));
  return nodes;
}
