/**
 * Connection to the server: the state, then events; reconnects when the connection is lost.
 *
 * @import {Event, State, Tone} from "./types.js"
 */
import { address, ApiError, get } from "./api.js";

/** Time without a message after which the connection counts as lost; the state changes every second, ms. */
const SILENCE_MS = 6000;
const FIRST_DELAY_MS = 400;
const MAX_DELAY_MS = 8000;

/**
 * @typedef {object} Listener
 * @property {(state: State) => void} state
 * @property {(tone: Tone) => void} tone
 * @property {() => void} stored
 * @property {() => void} linked called once the state has arrived and events are open
 * @property {(isShutdown: boolean) => void} lost `isShutdown`: the daemon announced its shutdown
 * @property {() => void} locked called if a token is required; call `start` again after the login
 */

export class Link {
  /** @param {Listener} listener */
  constructor(listener) {
    this.listener = listener;
    /** @type {WebSocket|null} */
    this.socket = null;
    this.failures = 0;
    this.isShutdown = false;
    this.timer = 0;
    this.silence = 0;
    this.trying = false;
    addEventListener("online", () => this.hurry());
    document.addEventListener("visibilitychange", () => this.hurry());
  }

  /** Whether the event connection is open. */
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
      this.isShutdown = false;
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
      else if (event.type === "shutdown") {
        this.isShutdown = true;
        this.end(socket);
      }
    });
  }

  /** Closes a silent connection without waiting for the close, which may take minutes. */
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
    this.listener.lost(this.isShutdown);
    const delay = Math.min(FIRST_DELAY_MS * 2 ** this.failures, MAX_DELAY_MS);
    this.failures += 1;
    clearTimeout(this.timer);
    // Random delays spread the load of several pages.
    this.timer = setTimeout(() => this.start(), delay * (0.8 + 0.4 * Math.random()));
  }

  /** Reconnects at once when the page becomes visible or the network returns. */
  hurry() {
    if (!document.hidden && this.failures > 0 && !this.trying && !this.up) this.start();
  }
}
