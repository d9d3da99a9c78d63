/** The token: asked for where the server wants one, or taken from `/#token=…`. */
import { login } from "./api.js";
import { byId, say } from "./dom.js";

/** Logs in with a token from the address, which is taken out of it. */
export async function loginFromAddress() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (!token) return;
  history.replaceState(null, "", `${location.pathname}${location.search}`);
  try {
    await login(token);
  } catch (error) {
    say(byId("login-fault"), /** @type {Error} */ (error).message);
  }
}

export function askToken() {
  byId("login").hidden = false;
  byId("token").focus();
}

/** @param {() => void} done called after a login; the form closes once the server answers */
export function startLogin(done) {
  byId("login").querySelector("form").addEventListener("submit", async (/** @type {SubmitEvent} */ event) => {
    event.preventDefault();
    const input = byId("token");
    try {
      await login(input.value.trim());
    } catch (error) {
      say(byId("login-fault"), /** @type {Error} */ (error).message);
      input.select();
      return;
    }
    input.value = "";
    say(byId("login-fault"), "");
    done();
  });
}
