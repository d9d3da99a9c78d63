/**
 * The link to the server: the state once, then its events; again and again when it is lost.
 *
 * @import {Event, State, Tone} from "./types.js"
 */
import { address, ApiError, get } from "./api.js";

/** The clock in the state changes every second: a longer silence is a dead line. */
const SILENCE_MS = 6000;
const FIRST_DELAY_MS = 400;
const LONGEST_DELAY_MS = 8000;

/**
 * @typedef {object} Listener
 * @property {(state: State) => void} state
 * @property {(tone: Tone) => void} tone
 * @property {() => void} stored
 * @property {() => void} linked the state has arrived and events follow
 * @property {(bye: boolean) => void} lost `bye`: the daemon said that it stops
 * @property {() => void} locked a token is asked for; `start` again after the login
 */

export class Link {
  /** @param {Listener} listener */
  constructor(listener) {
    this.listener = listener;
    /** @type {WebSocket|null} */
    this.socket = null;
    this.failures = 0;
    this.bye = false;
    this.timer = 0;
    this.silence = 0;
    this.trying = false;
    addEventListener("online", () => this.hurry());
    document.addEventListener("visibilitychange", () => this.hurry());
  }

  /** Whether events arrive. */
  get up() {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  async start() {
    if (this.trying || this.up) return;
    clearTimeout(this.timer);
    this.trying = true;
    try {
      this.listener.state(await get("api/state", 5000));
      await this.open();
      this.failures = 0;
      this.bye = false;
      this.listener.linked();
    } catch (error) {
      if (error instanceof ApiError && error.status === 401) this.listener.locked();
      else this.retry();
    } finally {
      this.trying = false;
    }
  }

  /** @returns {Promise<void>} */
  open() {
    const url = address("api/events").replace(/^http/, "ws");
    const socket = new WebSocket(url);
    this.socket = socket;
    this.listen(socket);
    return new Promise((resolve, reject) => {
      socket.addEventListener("open", () => resolve());
      socket.addEventListener("open", () => socket.addEventListener("close", () => this.end(socket)));
      socket.addEventListener("close", () => reject(new Error("no events")));
    });
  }

  /** @param {WebSocket} socket */
  listen(socket) {
    this.expect(socket);
    socket.addEventListener("message", ({ data }) => {
      if (socket !== this.socket) return;
      this.expect(socket);
      /** @type {Event} */
      const event = JSON.parse(data);
      if (event.type === "state") this.listener.state(event.state);
      else if (event.type === "tone") this.listener.tone(event.tone);
      else if (event.type === "stored") this.listener.stored();
      else if (event.type === "bye") {
        this.bye = true;
        this.end(socket);
      }
    });
  }

  /** Gives up a line on which nothing comes; closing it may take minutes, so that is not awaited. */
  expect(/** @type {WebSocket} */ socket) {
    clearTimeout(this.silence);
    this.silence = setTimeout(() => this.end(socket), SILENCE_MS);
  }

  /** @param {WebSocket} socket */
  end(socket) {
    if (socket !== this.socket) return;
    clearTimeout(this.silence);
    this.socket = null;
    socket.close();
    if (!this.trying) this.retry();
  }

  retry() {
    this.socket = null;
    this.listener.lost(this.bye);
    const delay = Math.min(FIRST_DELAY_MS * 2 ** this.failures, LONGEST_DELAY_MS);
    this.failures += 1;
    clearTimeout(this.timer);
    // Spread out, or all pages of a lab would ask at once.
    this.timer = setTimeout(() => this.start(), delay * (0.8 + 0.4 * Math.random()));
  }

  /** Someone looks again, or the network is back: no reason to wait any longer. */
  hurry() {
    if (!document.hidden && this.failures > 0 && !this.trying && !this.up) this.start();
  }
}
