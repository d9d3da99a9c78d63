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
import { deliversFrames, isFault, rates, stateWords, problems } from "./words.js";

const STILL_FETCHERS = 2;
/** Minimum interval between two images of a camera; the server makes ten per second, ms. */
const STILL_INTERVAL_MS = 100;
const RETRY_MS = 2000;
const LOCK = "gripcast-streams";

/**
 * @typedef {object} Tile
 * @property {Role} role
 * @property {any} figure
 * @property {HTMLImageElement} image
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
  }

  /** @param {State} state */
  draw(state) {
    const roles = state.cameras.map(({ role }) => role);
    if (roles.join() !== [...this.tiles.keys()].join()) this.createTiles(roles);
    for (const camera of state.cameras) this.caption(camera, state.contact);
  }

  /** @param {Role[]} roles */
  createTiles(roles) {
    const box = byId("images");
    this.tiles = new Map(roles.map((role) => [role, tile(role)]));
    box.replaceChildren(...[...this.tiles.values()].map(({ figure }) => figure));
    box.style.setProperty("--count", String(roles.length));
    if (this.running) this.start();
  }

  /** @param {Camera} camera @param {State["contact"]} contact */
  caption(camera, contact) {
    const tile = this.tiles.get(camera.role);
    if (!tile) return;
    const touch = camera.role === "left" || camera.role === "right" ? contact?.[camera.role] : null;
    const words = typeof touch === "number" ? `contact ${touch.toFixed(1)}` : "";
    refill(tile.health, [camera, words], () => health(camera, words));
    const delivers = deliversFrames(camera);
    style(tile.figure, isFault(camera) ? "failed" : delivers ? "" : "waiting");
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
    tile.image.src = address(`api/cameras/${tile.role}/preview.mjpg?start=${Date.now()}`);
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
      const response = await fetch(address(`api/cameras/${tile.role}/preview.jpg`), {
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

/** @param {Role} role @returns {Tile} */
function tile(role) {
  const image = make("img");
  image.alt = role === "left" || role === "right" ? `${role} gel, difference to the initial frame` : `${role} camera`;
  image.dataset.role = role;
  const name = button(role, openSensors, "role");
  name.title = "sensors in detail (h)";
  const words = make("span", "health");
  const caption = make("figcaption", "", name, words);
  const cover = make("span", "cover");
  const figure = make("figure", "", caption, make("div", "frame", image, cover));
  figure.dataset.role = role;
  return { role, figure, image, health: words, cover, state: "", due: 0, busy: false };
}

/** Frame rate, age, contact and problems. @param {Camera} camera @param {string} contact */
function health(camera, contact) {
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
  if (camera.reason) nodes.push(make("span", "slip", camera.reason));
  return nodes;
}
