/** Requests to the server. @import {CommandResponse, Seen} from "./types.js" */
import { newId, sender } from "./sender.js";

/** Timeout of a request; a save may wait for a slow disk, ms. */
const TIMEOUT_MS = 30000;

/** Error response of the server. */
export class ApiError extends Error {
  /** @param {number} status 0 without a response, -1 if nothing was sent @param {string} what @param {string|null} remedy */
  constructor(status, what, remedy = null) {
    super(remedy ? `${what}: ${remedy}` : what);
    this.status = status;
  }

  /** Whether the change may have been made: it was sent, and gripcast did not refuse it. */
  get isUncertain() {
    return this.status === 0 || this.status >= 500;
  }
}

/** Why no change can be sent; null while connected. @type {() => string|null} */
let offline = () => "not connected";
/** Changes without an answer yet. @type {Set<AbortController>} */
const unanswered = new Set();

/** @param {() => string|null} reason why no change can be sent; null while connected */
export function watchConnection(reason) {
  offline = reason;
}

/** Gives up the changes without an answer: the connection is lost. */
export function abandonChanges() {
  for (const request of unanswered) request.abort();
}

/** Absolute URL of a path relative to the page, which may have a prefix. @param {string} path */
export function address(path) {
  return new URL(path, document.baseURI).href;
}

/** @param {string} method @param {string} path @param {object} [body] @param {number} [timeout_ms] @param {AbortController} [request] */
async function send(method, path, body, timeout_ms = TIMEOUT_MS, request = new AbortController()) {
  const timer = setTimeout(() => request.abort(), timeout_ms);
  try {
    const response = await fetch(address(path), {
      method,
      cache: "no-store",
      signal: request.signal,
      headers: body ? { "Content-Type": "application/json" } : {},
      body: body && JSON.stringify(body),
    });
    return { response, answer: await response.json().catch(() => null) };
  } catch {
    throw new ApiError(0, "no answer from gripcast");
  } finally {
    clearTimeout(timer);
  }
}

/** @param {Response} response @param {any} answer */
function errorOf(response, answer) {
  const error = answer?.error;
  const where = error?.where ? ` (${error.where})` : "";
  return new ApiError(response.status, error ? `${error.what}${where}` : `HTTP ${response.status}`, error?.remedy ?? null);
}

/** GET request for JSON. @param {string} path @param {number} [timeout_ms] @returns {Promise<any>} */
export async function get(path, timeout_ms) {
  const { response, answer } = await send("GET", path, undefined, timeout_ms);
  if (!response.ok || answer === null) throw errorOf(response, answer);
  return answer;
}

/** Version of the server, also when it is unhealthy. @returns {Promise<string|null>} */
export async function version() {
  const { answer } = await send("GET", "api/health", undefined, 5000);
  return answer?.version ?? null;
}

/**
 * Request for a change. A refusal is a valid response, not an error. Without a connection nothing is
 * sent: a request on a dead line would arrive later.
 * @param {string} method @param {string} path @param {object} [body]
 * @param {{id?: string, pressedAt?: number, seen?: Seen}} [press] defaults: a new id, now, nothing
 * @returns {Promise<CommandResponse>}
 */
export async function change(method, path, body, press = {}) {
  const reason = offline();
  if (reason) throw new ApiError(-1, `not sent: ${reason}`);
  const { id = newId(), pressedAt = performance.now(), seen = {} } = press;
  const request = new AbortController();
  unanswered.add(request);
  try {
    const whole = { ...body, sender: sender(id, pressedAt, seen) };
    const { response, answer } = await send(method, path, whole, TIMEOUT_MS, request);
    if (typeof answer?.result === "string") return answer;
    throw errorOf(response, answer);
  } catch (error) {
    const failure = /** @type {ApiError} */ (error);
    if (failure.isUncertain) failure.message += ": not known whether it was carried out";
    throw failure;
  } finally {
    unanswered.delete(request);
  }
}

/**
 * Result of a command whose answer did not arrive; null if the server does not know it.
 * @param {string} id
 * @returns {Promise<CommandResponse|null>}
 */
export async function resultOf(id) {
  const { answer } = await send("GET", `api/commands/${id}`);
  return typeof answer?.result === "string" ? answer : null;
}

/** Reason why a command was not executed, in one line. @param {CommandResponse} answer */
export function failureReason(answer) {
  return answer.error ?? (answer.reasons?.join("; ") || "refused");
}

/** Whether this browser is logged in; scripts cannot read the cookie. @returns {Promise<boolean>} */
export async function loggedIn() {
  return (await get("api/login", 5000)).logged_in;
}

/** Ends the session in all windows of this browser. */
export async function logout() {
  const { response, answer } = await send("POST", "api/logout");
  // 401: the session has already ended.
  if (!response.ok && response.status !== 401) throw errorOf(response, answer);
}

/** @param {string} token */
export async function login(token) {
  const { response, answer } = await send("POST", "api/login", { token });
  if (!response.ok) throw errorOf(response, answer);
}
