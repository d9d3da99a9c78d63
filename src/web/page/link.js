/**
 * Connection to the server: the state, then events; reconnects when the connection is lost. Where a
 * proxy blocks WebSockets, the state is fetched repeatedly instead.
 *
 * @import {Event, State, Tone} from "./types.js"
 */
import { address, ApiError, get } from "./api.js";

/** Time without a message after which the connection counts as lost; the state changes every second, ms. */
const SILENCE_MS = 6000;
const FIRST_DELAY_MS = 400;
const MAX_DELAY_MS = 8000;
/** Interval of fetched states, ms. */
const POLL_MS = 400;
/** Timeout of a fetched state, ms. */
const POLL_TIMEOUT_MS = 3000;
/** Interval of attempts to open events while states are fetched, ms. */
const EVENTS_RETRY_MS = 30000;

/**
 * @typedef {object} Listener
 * @property {(state: State) => void} state
 * @property {(tone: Tone) => void} tone
 * @property {() => void} stored
 * @property {(hasEvents: boolean) => void} linked called once the state has arrived; without events
 *   states are fetched, and there are no tones
 * @property {(isShutdown: boolean, reason: string|null) => void} lost `isShutdown`: the daemon
 *   announced its shutdown; `reason`: why it refuses this page
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
    /** Number of the polling in progress; 0 for none. */
    this.polling = 0;
    this.polls = 0;
    addEventListener("online", () => this.hurry());
    document.addEventListener("visibilitychange", () => this.hurry());
  }

  /** Whether states arrive. */
  get up() {
    return this.polling > 0 || this.socket?.readyState === WebSocket.OPEN;
  }

  async start() {
    if (this.trying || this.up) return;
    clearTimeout(this.timer);
    this.trying = true;
    try {
      this.listener.state(await get("api/state", 5000));
      const hasEvents = await this.open().then(
        () => true,
        () => false,
      );
      // Not a lost connection: the state still comes.
      if (!hasEvents) this.listener.state(await get("api/state", 5000));
      this.failures = 0;
      this.isShutdown = false;
      if (!hasEvents) this.poll();
      this.listener.linked(hasEvents);
    } catch (error) {
      const { status, message } = /** @type {ApiError} */ (error);
      if (error instanceof ApiError && status === 401) this.listener.locked();
      else this.retry(error instanceof ApiError && status > 0 ? message : null);
    } finally {
      this.trying = false;
    }
  }

  /** Fetches states until one does not come, or events can be opened. */
  async poll() {
    this.polls += 1;
    const round = this.polls;
    this.polling = round;
    let revision = -1;
    let retryAt = performance.now() + EVENTS_RETRY_MS;
    while (this.polling === round) {
      await new Promise((resolve) => setTimeout(resolve, POLL_MS));
      try {
        const state = await get("api/state", POLL_TIMEOUT_MS);
        this.listener.state(state);
        if (revision >= 0 && state.session.revision !== revision) this.listener.stored();
        revision = state.session.revision;
      } catch {
        this.polling = 0;
        this.retry(null);
        return;
      }
      if (performance.now() < retryAt) continue;
      retryAt = performance.now() + EVENTS_RETRY_MS;
      this.open().then(
        () => {
          this.polling = 0;
          this.listener.linked(true);
        },
        () => {},
      );
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
    if (!this.trying && !this.polling) this.retry(null);
  }

  /** @param {string|null} reason */
  retry(reason) {
    this.socket = null;
    this.listener.lost(this.isShutdown, reason);
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
