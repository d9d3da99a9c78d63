/** Login with a token, typed or from `/#token=…`, and logout. */
import { loggedIn, login, logout } from "./api.js";
import { byId, say, toast } from "./dom.js";

/** Logs in with a token from the address and removes it from the address. */
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

/** Shows the logout button if logged in. */
export async function drawLogout() {
  byId("logout").hidden = !(await loggedIn().catch(() => false));
}

/** Reloads the page after a logout, which then asks for the token. */
export function startLogout() {
  byId("logout").addEventListener("click", async () => {
    try {
      await logout();
    } catch (error) {
      toast(/** @type {Error} */ (error).message, "error");
      return;
    }
    location.reload();
  });
}

/** @param {() => void} done called after a login */
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
