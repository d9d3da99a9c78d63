"""Tests the web page in a headless Chromium, with screenshots.

    apt-get install chromium; python3 -m venv venv
    venv/bin/pip install playwright aiohttp numpy pillow
    venv/bin/python tests/web/e2e.py [--shots DIR]                  # against tests/peers/web_mock.py
    venv/bin/python tests/web/e2e.py --url http://127.0.0.1:8765 [--token T] [--shots DIR]
    venv/bin/python tests/web/e2e.py --serve 'gripcast daemon … --listen 127.0.0.1:{port}' [--token T]

With --url a running server is used and its dataset is changed: use a disposable dataset. With
--serve the command is started, stopped and restarted by the test. Checks that need simulated faults
run against the mock only; skipped checks are listed. Prints one line per check; exit code 1 if any
check failed.
"""

import argparse
import asyncio
import contextlib
import json
import os
import pathlib
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import traceback
import urllib.error
import urllib.request

from playwright.async_api import async_playwright

ROOT = pathlib.Path(__file__).resolve().parents[2]
HOSTILE = "<img src=x onerror=alert(1)> “mug” & co"
PHONE, TABLET, DESKTOP = (360, 640), (1280, 800), (1920, 1080)
SPY = """
window.seen = { policy: [], tones: [], alerts: 0 };
document.addEventListener("securitypolicyviolation", (e) => window.seen.policy.push(`${e.violatedDirective} ${e.blockedURI}`));
window.alert = () => { window.seen.alerts += 1; };
const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (at) { window.seen.tones.push(this.frequency.value); return start.call(this, at); };
"""
# Checks the contrast of all visible texts against WCAG AA.
CONTRAST = """() => {
  const channels = (text) => (text.match(/[\\d.]+/g) ?? []).map(Number);
  const linear = (v) => { v /= 255; return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; };
  const light = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  const ground = (node) => {
    for (let at = node; at; at = at.parentElement) {
      const colour = channels(getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] === 1) return colour;
    }
    return [255, 255, 255];
  };
  const low = [];
  let count = 0;
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let text = walker.nextNode(); text; text = walker.nextNode()) {
    const node = text.parentElement;
    if (!text.data.trim() || !node.checkVisibility({ visibilityProperty: true })) continue;
    if (node.closest(".cover, .unseen, script")) continue;
    count += 1;
    const style = getComputedStyle(node);
    const [a, b] = [light(channels(style.color)), light(ground(node))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    const size = parseFloat(style.fontSize);
    const large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
    if (ratio < (large ? 3 : 4.5)) low.push(`${ratio.toFixed(2)} ${text.data.trim().slice(0, 30)}`);
  }
  return { count, low };
}"""


class Server:
    """Server under test: the mock, a command, or a running server."""

    def __init__(self, options, token=None):
        self.token = token or options.token
        self.process = None
        self.mock = not options.url and not options.serve
        self.url = options.url
        self.environment, self.unplugged = None, None
        if options.serve:
            self.unplugged = pathlib.Path(tempfile.mkdtemp()) / "unplugged"
            self.environment = os.environ | {"GRIPCAST_VIRTUAL_UNPLUGGED": str(self.unplugged)}
        if not self.url:
            self.port = free_port()
            self.url = f"http://127.0.0.1:{self.port}"
            mock = [sys.executable, str(ROOT / "tests/peers/web_mock.py"), "--port", str(self.port)]
            if self.token:
                mock += ["--token", self.token]
            self.command = shlex.split(options.serve.format(port=self.port)) if options.serve else mock

    @property
    def restartable(self):
        return self.process is not None

    async def start(self):
        if hasattr(self, "command"):
            self.process = subprocess.Popen(self.command, env=self.environment)
        for _ in range(600):
            with contextlib.suppress(OSError):
                with urllib.request.urlopen(f"{self.url}/", timeout=2):
                    return
            await asyncio.sleep(0.1)
        sys.exit(f"no server responds at {self.url}")

    def stop(self, how=signal.SIGTERM):
        if self.process:
            self.process.send_signal(how)
            self.process.wait(30)

    def call(self, path, method="GET", body=None):
        headers = {"Content-Type": "application/json"}
        if self.token:
            headers["Authorization"] = f"Bearer {self.token}"
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"{self.url}{path}", data, headers, method=method)
        try:
            with urllib.request.urlopen(request, timeout=30) as answer:
                return json.load(answer)
        except urllib.error.HTTPError as error:
            return json.load(error)

    def state(self):
        return self.call("/api/state")

    def unplug(self, *roles):
        self.unplugged.write_text("\n".join(roles))

    def order(self, **control):
        self.call("/mock", "POST", control)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Proxy:
    """A reverse proxy like nginx: without options `Host` is replaced and a WebSocket is blocked.

    `prefix` is replaced by `/`, as `location PREFIX { proxy_pass http://…/; }` does. While `dead_up` or
    `dead_down` is true, no byte passes in that direction and all connections stay open, as on a lost
    Wi-Fi.
    """

    def __init__(self, port, host=False, upgrade=False, prefix="/"):
        self.target, self.host, self.upgrade, self.prefix = port, host, upgrade, prefix
        self.dead_up = self.dead_down = False
        self.connections = set()

    async def __aenter__(self):
        self.server = await asyncio.start_server(self.serve, "127.0.0.1", 0)
        self.url = f"http://127.0.0.1:{self.server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(self, *_):
        self.server.close()
        for task in self.connections:
            task.cancel()

    async def serve(self, reader, writer):
        self.connections.add(asyncio.current_task())
        with contextlib.suppress(OSError, EOFError, asyncio.CancelledError):
            head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
            line, *headers = head.split("\r\n")[:-2]
            method, path, version = line.split(" ")
            if not path.startswith(self.prefix):
                writer.write(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
                return writer.close()
            switches = self.upgrade and any(each.lower().startswith("upgrade:") for each in headers)
            own = ["connection"] + ([] if self.host else ["host"]) + ([] if switches else ["upgrade"])
            headers = [each for each in headers if each.split(":")[0].lower() not in own]
            headers.append(f"Connection: {'upgrade' if switches else 'close'}")
            if not self.host:
                headers.append(f"Host: 127.0.0.1:{self.target}")
            path = "/" + path[len(self.prefix) :]
            up_reader, up_writer = await asyncio.open_connection("127.0.0.1", self.target)
            up_writer.write("\r\n".join([f"{method} {path} {version}", *headers, "", ""]).encode("latin-1"))
            pumps = (self.pump(reader, up_writer, "dead_up"), self.pump(up_reader, writer, "dead_down"))
            await asyncio.gather(*pumps)
        self.connections.discard(asyncio.current_task())

    async def pump(self, reader, writer, dead):
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                while getattr(self, dead):
                    await asyncio.sleep(0.05)
                writer.write(data)
                await writer.drain()
        writer.close()


class Driver:
    def __init__(self, browser, server, shots):
        self.browser, self.server, self.shots = browser, server, shots
        self.failed = []
        self.passed = 0
        self.noise = []
        self.quiet = True

    def check(self, what, good, found=""):
        if good:
            self.passed += 1
        else:
            self.failed.append(what)
        print(f"{'ok  ' if good else 'FAIL'} {what}{'' if good or found == '' else f': {found}'}", flush=True)

    async def context(self, size=TABLET, scheme="dark", **more):
        context = await self.browser.new_context(
            viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, **more
        )
        await context.add_init_script(SPY)
        return context

    async def page(self, context, path="/", url=None):
        page = await context.new_page()
        page.on("pageerror", lambda error: self.noise.append(f"error: {error}"))
        page.on("console", self.listen)
        if self.server.token and "#" not in path:
            path = f"{path}#token={self.server.token}"
        await page.goto(f"{url or self.server.url}{path}", wait_until="domcontentloaded")
        if self.server.token is None or "token=" in path:
            await page.locator("#steps .here").wait_for(state="attached")
            await page.locator("body:not(.offline)").wait_for()
        return page

    def listen(self, message):
        # The browser reports all responses of 400 and above, and a stopped server.
        own = "Failed to load resource" in message.text or "WebSocket connection" in message.text
        if message.type in ("error", "warning") and not own:
            self.noise.append(f"{message.type}: {message.text}")

    async def tap(self, page, selector):
        """Taps a button as a person does: not within the time of a double tap."""
        await asyncio.sleep(0.4)
        await page.locator(f"{selector}:not([aria-disabled])").click()

    async def shot(self, page, name):
        if self.shots:
            await page.screenshot(path=self.shots / f"{name}.png")

    async def until(self, what, test, seconds=20):
        """Waits until test() is true: the server tells, no time is assumed."""
        for _ in range(int(seconds * 20)):
            value = test()
            if asyncio.iscoroutine(value):
                value = await value
            if value:
                self.check(what, True)
                return True
            await asyncio.sleep(0.05)
        self.check(what, False, "did not come")
        return False

    def step(self):
        session = self.server.state()["session"]
        return None if session["saving"] else session["step"]

    async def advance(self, page, wanted, act):
        """Presses until the wanted step is there; a live rig may refuse a moment, as for a person."""
        for _ in range(30):
            await act()
            for _ in range(60):
                await asyncio.sleep(0.1)
                session = self.server.state()["session"]
                if session["saving"]:
                    continue
                if session["step"] == wanted:
                    break
                if session["refusal"]:
                    if session["refusal"]["can_override"]:
                        self.server.call("/api/commands", "POST", {"command": "override"})
                    break
            if self.step() == wanted:
                break
        await page.locator(f"#trigger.{wanted}").wait_for(state="attached", timeout=10000)
        self.check(f"step {wanted} is shown", await page.locator("#steps .here .digit").inner_text() == {"initial": "1", "grasp": "2", "label": "3"}[wanted])

    async def go_to(self, page, wanted):
        """From wherever the session is to the first step."""
        for _ in range(6):
            step = self.step()
            if step == wanted:
                return
            command = {"initial": "trigger", "grasp": "trigger", "label": "slip"}.get(step)
            if command:
                answer = self.server.call("/api/commands", "POST", {"command": command})
                if answer.get("can_override"):
                    self.server.call("/api/commands", "POST", {"command": "override"})
            await asyncio.sleep(0.7)
        self.check(f"the session comes to {wanted}", self.step() == wanted)

    async def quality(self, page, what):
        await self.legible(page, what)
        wide = await page.evaluate("document.documentElement.scrollWidth > innerWidth || [...document.querySelectorAll('main')].some((m) => m.scrollWidth > m.clientWidth + 1)")
        self.check(f"{what}: nothing is wider than the screen", not wide)

    async def legible(self, page, what):
        found = await page.evaluate(CONTRAST)
        self.check(f"{what}: contrast AA of {found['count']} texts", found["count"] > 3 and not found["low"], found["low"])


async def cycle(d, context):
    """Initial, grasp, label, undo and redo by buttons, watched from a second page."""
    page = await d.page(context)
    other = await d.page(await d.context(PHONE, "light"))
    await d.go_to(page, "initial")
    before = d.server.state()["session"]["counts"]
    await d.advance(page, "grasp", lambda: d.tap(page, "#trigger"))
    await d.shot(page, "desktop-initial" if page.viewport_size["width"] > 1300 else "tablet-grasp")
    await d.advance(page, "label", lambda: d.tap(page, "#trigger"))
    state = d.server.state()["session"]
    d.check("the grasp is not labelled yet", state["last"]["outcome"] == "unlabelled")
    d.check("the trigger rests while a label is wanted", await page.locator("#trigger").get_attribute("aria-disabled") == "true")
    await d.shot(page, "tablet-label")
    await d.tap(page, "#stable")
    await d.until("stable is counted", lambda: d.server.state()["session"]["counts"]["stable"] == before["stable"] + 1)
    await other.locator("#trigger.initial").wait_for()
    for each in (page, other):
        await each.locator("#last >> text=STABLE").wait_for()
    d.check("both pages show the same counts", await agree(page, other, "#counts"))
    await d.tap(page, "#undo")
    await d.until("undo removes the label", lambda: d.server.state()["session"]["counts"]["stable"] == before["stable"])
    await other.locator("#actions.labelling").wait_for()
    d.check("the other page follows", await agree(page, other, "#last"))
    await other.locator("#redo:not([aria-disabled])").click()
    await d.until("redo from the other page", lambda: d.server.state()["session"]["counts"]["stable"] == before["stable"] + 1)
    await d.tap(page, "#slip")
    await d.until("a label can be changed", lambda: d.server.state()["session"]["last"]["outcome"] == "slip")
    await page.locator("#last >> text=SLIP").wait_for()
    d.check("nothing was laid on top by names", (await page.evaluate("window.seen.alerts")) == 0)
    await other.context.close()
    return page


async def true(page, script, seconds=20):
    """Waits for a script; Playwright's own wait would need `unsafe-eval`."""
    for _ in range(seconds * 20):
        if await page.evaluate(script):
            return
        await asyncio.sleep(0.05)
    raise TimeoutError(script)


async def agree(page, other, selector):
    for _ in range(40):
        texts = [await each.locator(selector).inner_text() for each in (page, other)]
        if texts[0] == texts[1]:
            return True
        await asyncio.sleep(0.1)
    return False


async def keyboard(d, context):
    """A whole grasp without a pointer."""
    page = await d.page(context)
    await d.go_to(page, "initial")
    await d.advance(page, "grasp", lambda: page.keyboard.press("Space"))
    await page.keyboard.press("i")
    await d.until("i takes the initial frame again", lambda: d.step() == "grasp" and d.server.state()["session"]["undo"] == "initial frame")
    await d.advance(page, "label", lambda: page.keyboard.press("Space"))
    await page.keyboard.press("f")
    await d.until("f labels slip", lambda: d.server.state()["session"]["last"]["outcome"] == "slip")
    await page.locator("#undo:not([aria-disabled])").wait_for()
    await page.keyboard.press("u")
    await d.until("u undoes", lambda: d.step() == "label")
    await page.locator("#redo:not([aria-disabled])").wait_for()
    await page.keyboard.press("r")
    await d.until("r does it again", lambda: d.step() == "initial")
    await page.keyboard.press("o")
    await page.locator("#name-dialog[open]").wait_for()
    await d.shot(page, "names")
    await page.keyboard.type(HOSTILE)
    await page.keyboard.press("Enter")
    await d.until("o names the object, whatever the name", lambda: d.server.state()["session"]["object"] == HOSTILE)
    await page.locator(f"#names >> text={HOSTILE}").wait_for()
    d.check("a hostile name is text", await page.locator("#names img").count() == 0)
    await page.keyboard.press("o")
    await page.keyboard.type("never")
    await page.keyboard.press("Escape")
    await page.locator("#name-dialog").wait_for(state="hidden")
    d.check("Esc keeps the name", d.server.state()["session"]["object"] == HOSTILE)
    d.server.call("/api/object", "PUT", {"name": "mug"})
    await page.keyboard.press("?")
    await page.locator("#help-dialog[open]").wait_for()
    await d.legible(page, "keys")
    await d.shot(page, "keys")
    await asyncio.sleep(0.2)  # longer than the interval of a held key
    await page.keyboard.press("?")
    await page.locator("#help-dialog").wait_for(state="hidden")
    await page.keyboard.press("h")
    await page.locator("#sensors-dialog[open]").wait_for()
    await d.shot(page, "sensors")
    await asyncio.sleep(0.2)
    await page.keyboard.press("h")
    await page.locator("#sensors-dialog").wait_for(state="hidden")
    await page.keyboard.press("l")
    await page.locator("#gallery .card").first.wait_for()
    reached = []
    for _ in range(40):
        await page.keyboard.press("Tab")
        at = await page.evaluate("[document.activeElement.id || document.activeElement.className, getComputedStyle(document.activeElement).outlineStyle]")
        reached.append(at[0])
        if at[0] == "card":
            break
    d.check("Tab comes to a card, with a visible focus", at == ["card", "solid"], reached)
    await page.keyboard.press("Enter")
    await page.locator("#detail-dialog[open] .detail-images img").first.wait_for()
    title = await page.locator("#detail-title").inner_text()
    await page.keyboard.press("ArrowRight")
    await page.locator(f"#detail-title:not(:text-is({json.dumps(title)}))").wait_for()
    d.check("→ goes to the older grasp", True)
    await page.keyboard.press("s")
    await page.keyboard.press("Escape")
    d.check("letters do not label behind a panel", d.server.state()["session"]["last"]["outcome"] == "slip")
    await page.close()


IDS = "[...document.querySelectorAll('#gallery > li')].map((c) => c.dataset.id)"


async def sieve(d, page):
    """Filters by object and date, alone and together with the outcome."""
    objects = d.server.call("/api/objects")["objects"]
    name = objects[0]["object"]
    count = sum(objects[0][each] for each in ("stable", "slip", "unlabelled"))
    await page.locator("#object-filter").select_option(name)
    await d.until(f"object filter shows {min(count, 24)}", lambda: counted(page, min(count, 24)))
    await page.locator("[data-filter=slip]").click()
    await d.until("object and outcome together", lambda: counted(page, min(objects[0]["slip"], 24)))
    await d.shot(page, "gallery-filtered")
    await page.locator("[data-filter=all]").click()
    await page.locator("#object-filter").select_option("")
    today = await page.evaluate("new Date(Date.now() - new Date().getTimezoneOffset() * 60e3).toISOString().slice(0, 10)")
    await page.locator("#from-filter").fill("2200-01-01")
    await page.locator("#gallery-note:has-text('no matching grasp')").wait_for()
    d.check("no grasp of the future", await page.locator("#gallery > li").count() == 0)
    await page.locator("#from-filter").fill("2020-01-01")
    await page.locator("#to-filter").fill(today)
    total = sum(sum(each[o] for o in ("stable", "slip", "unlabelled")) for each in objects)
    await d.until("up to today: all", lambda: counted(page, min(total, 24)))
    await page.locator("#to-filter").fill("2020-01-02")
    await d.until("a day without grasps: none", lambda: counted(page, 0))
    for each in ("#from-filter", "#to-filter"):
        await page.locator(each).fill("")
    await d.until("without filters: all", lambda: counted(page, min(total, 24)))


async def bulk(d, page):
    """Many labels at once: asked first, then undone step by step."""
    await page.locator("#select").click()
    cards = page.locator("#gallery .card")
    listed = page.locator("#gallery > li")
    chosen = [await listed.nth(i).get_attribute("data-id") for i in range(min(3, await listed.count()))]
    before = {key: d.server.call(f"/api/grasps/{key}")["outcome"] for key in chosen}
    wanted = "slip" if list(before.values()).count("slip") < 2 else "stable"
    moved = [key for key in chosen if before[key] != wanted]
    for i in range(len(chosen)):
        await cards.nth(i).click()
    await page.locator(f"#bulk >> text={len(chosen)} selected").wait_for()
    await d.shot(page, "gallery-select")
    await d.legible(page, "selection")
    await page.locator(f"#bulk .{wanted}").click()
    await page.locator("#bulk-dialog[open]").wait_for()
    words = await page.locator("#bulk-dialog").inner_text()
    d.check("it is asked before many labels change", f"{len(moved)} grasp" in words and "Undo" in words, words)
    await page.keyboard.press("Escape")
    d.check("Esc changes nothing", all(d.server.call(f"/api/grasps/{key}")["outcome"] == before[key] for key in chosen))
    await page.locator(f"#bulk .{wanted}").click()
    await page.locator("#bulk-dialog .primary").click()
    await d.until(f"{len(moved)} labels change", lambda: all(d.server.call(f"/api/grasps/{key}")["outcome"] == wanted for key in chosen))
    await page.locator(f"#toasts >> text={len(moved)} labelled").wait_for()
    await page.locator("#bulk button:text-is('Done')").click()
    await page.locator("#bulk").wait_for(state="hidden")
    for key in reversed(moved):
        d.server.call("/api/commands", "POST", {"command": "undo"})
        d.check("each label is one undo", d.server.call(f"/api/grasps/{key}")["outcome"] == before[key])
    await page.locator(f"#gallery > li[data-id='{moved[0]}'] .line:has-text('{ {'stable': 'STABLE', 'slip': 'SLIP', 'unlabelled': 'not labelled'}[before[moved[0]]] }')").wait_for()


async def gallery(d, context):
    """List, filters, paging, detail, relabelling, trash and restore, seen from two pages."""
    page = await d.page(context)
    other = await d.page(context, "/#grasps")
    await page.goto(f"{d.server.url}/#grasps")
    await page.locator("#gallery .card").first.wait_for()
    await true(page, "[...document.querySelectorAll('.thumbs img')].slice(0, 6).every((i) => i.complete && i.naturalWidth > 0)")
    await d.shot(page, "gallery")
    await d.quality(page, "gallery")
    for name, query in (("disagree", "&disagree=true"), ("unlabelled", "&outcome=unlabelled"), ("slip", "&outcome=slip"), ("stable", "&outcome=stable")):
        await page.locator(f"[data-filter={name}]").click()
        wanted = [g["id"] for g in d.server.call(f"/api/grasps?limit=24{query}")["grasps"]]
        ids = "[...document.querySelectorAll('#gallery > li')].map((c) => c.dataset.id)"
        await d.until(f"filter {name} shows {len(wanted)}", lambda ids=ids, wanted=wanted: equal(page, ids, wanted))
    await page.locator("[data-filter=all]").click()
    total = sum(d.server.state()["session"]["counts"][n] for n in ("stable", "slip", "unlabelled"))
    await d.until("all again", lambda: counted(page, min(total, 24)))
    if total > 24:
        await page.locator("#more").click()
        await d.until("more shows more", lambda: counted(page, min(total, 48)))
    await sieve(d, page)
    await bulk(d, page)
    newest = d.server.call("/api/grasps?limit=2")["grasps"][-1]
    card = page.locator(f"#gallery > li[data-id='{newest['id']}'] .card")
    await card.click()
    await true(page, "[...document.querySelectorAll('.detail-images img')].length > 5 && [...document.querySelectorAll('.detail-images img')].every((i) => i.complete && i.naturalWidth > 0)")
    await d.shot(page, "detail")
    await d.legible(page, "detail")
    turned = "stable" if newest["outcome"] == "slip" else "slip"
    await page.locator(f".detail-buttons .{turned}").click()
    await page.locator(f".detail-buttons .{turned}[aria-pressed=true]").wait_for()
    d.check("relabelled", d.server.call(f"/api/grasps/{newest['id']}")["outcome"] == turned)
    await other.locator(f"#gallery > li[data-id='{newest['id']}'] >> text={turned.upper()}").wait_for()
    d.check("the other page shows the new label", True)
    await page.get_by_role("button", name="edit object").click()
    await page.locator("#name").fill("corrected mug")
    await page.keyboard.press("Enter")
    await page.locator("#detail-title:has-text('corrected mug')").wait_for()
    d.check("object corrected", d.server.call(f"/api/grasps/{newest['id']}")["object"] == "corrected mug")
    await other.locator(f"#gallery > li[data-id='{newest['id']}'] >> text=corrected mug").wait_for()
    await page.locator(".detail-buttons .danger").click()
    await other.locator(f"#gallery > li[data-id='{newest['id']}']").wait_for(state="detached")
    d.check("trashed, on both pages", True)
    await page.locator("#detail >> text=Restore").wait_for()
    await d.shot(page, "trashed")
    await page.keyboard.press("Escape")
    await page.locator("#detail-dialog").wait_for(state="hidden")
    await page.locator("#trashed button").click()
    await page.locator(f"#gallery > li[data-id='{newest['id']}']").wait_for()
    await other.locator(f"#gallery > li[data-id='{newest['id']}']").wait_for()
    d.check("restored, on both pages", d.server.call(f"/api/grasps/{newest['id']}")["outcome"] == turned)
    d.check("the note of the trash is gone", await page.locator("#trashed li").count() == 0)
    small = await d.page(await d.context(PHONE, "light"), "/")
    await small.goto(f"{d.server.url}/#grasps")
    await small.locator("#gallery .card").first.wait_for()
    await d.quality(small, "gallery on a phone")
    await small.wait_for_timeout(800)
    await d.shot(small, "phone-gallery")
    await small.locator("#gallery .card").first.click()
    await true(small, "[...document.querySelectorAll('.detail-images img')].slice(0, 3).every((i) => i.complete && i.naturalWidth > 0)")
    await d.shot(small, "phone-detail")
    await small.context.close()
    await page.close()
    await other.close()


async def equal(page, script, wanted):
    return await page.evaluate(script) == wanted


async def counted(page, wanted):
    return await page.locator("#gallery > li").count() == wanted


async def images(d, context):
    """Two windows of one browser: one streams, the other fetches stills, and commands get through."""
    page = await d.page(context)
    other = await d.page(context)
    roles = [camera["role"] for camera in d.server.state()["cameras"]]
    ready = f"[...document.querySelectorAll('#images img:not(.earlier)')].filter((i) => i.naturalWidth > 0).length === {len(roles)}"
    for name, each in (("first", page), ("second", other)):
        await true(each, ready)
        d.check(f"{name} window shows all {len(roles)} cameras", True)
    sources = []
    for _ in range(100):
        sources = [await each.evaluate("document.querySelector('#images img').src.split(':')[0]") for each in (page, other)]
        if "http" in sources:
            break
        await asyncio.sleep(0.1)
    d.check("one window streams, the other fetches stills", sorted(sources) == ["blob", "http"], sources)
    before = await other.evaluate("document.querySelector('#images img').src")
    await true(other, f"document.querySelector('#images img').src !== {json.dumps(before)}")
    answer = await other.evaluate("fetch('api/state').then((r) => r.status)")
    d.check("six connections are enough", answer == 200)
    streaming = page if sources[0] == "http" else other
    waiting = other if sources[0] == "http" else page
    await streaming.close()
    await true(waiting, "document.querySelector('#images img').src.startsWith('http')")
    d.check("the stream moves to the window that is left", True)
    await waiting.close()


async def sound(d):
    context = await d.context()
    page = await d.page(context)
    await d.go_to(page, "initial")
    await page.locator("#sound").click()
    await page.locator("#sound >> text=♪ on").wait_for()
    await page.evaluate("window.seen.tones = []")
    await d.tap(page, "#trigger")
    if await d.until("the tone of a saved initial frame", lambda: tones(page, [660])):
        await page.evaluate("window.seen.tones = []")
        await d.tap(page, "#undo")
        await d.until("the tone of an undo", lambda: tones(page, [784, 784, 587]))
    again = await d.page(context)
    d.check("sound is remembered", await again.locator("#sound").get_attribute("aria-pressed") == "true")
    await context.close()


async def tones(page, wanted):
    return await page.evaluate("window.seen.tones") == wanted


async def targets(d, page, name):
    """The answer to the step is the largest button, and a finger hits every one."""
    boxes = await page.evaluate("""[...document.querySelectorAll('button, nav a')].filter((b) => b.checkVisibility() && !b.closest('#labels p'))
      .map((b) => { const r = b.getBoundingClientRect(); return { id: b.id || b.textContent, width: r.width, height: r.height, off: b.getAttribute("aria-disabled") === "true" }; })""")
    small = [box for box in boxes if min(box["width"], box["height"]) < 44]
    d.check(f"{name}: {len(boxes)} targets of 44 px", not small, small)
    actions = [box for box in boxes if box["id"] in ("trigger", "stable", "slip", "undo", "redo", "initial")]
    largest = max(actions, key=lambda box: box["width"] * box["height"])
    d.check(f"{name}: the largest button, {largest['id']}, is possible and 96 px high", not largest["off"] and largest["height"] >= 96, largest)


async def first_screen(d):
    """On a phone held upright, cameras, disk and answers are visible without scrolling, in every step."""
    for size in (PHONE, (390, 844)):
        page = await d.page(await d.context(size, "light"))
        for step in ("initial", "grasp", "label"):
            await d.go_to(page, step)
            await page.locator(f"#trigger.{step}").wait_for(state="attached")
            await true(page, "document.querySelectorAll('#images img:not(.earlier)').length > 0 && [...document.querySelectorAll('#images img:not(.earlier)')].every((i) => i.naturalWidth > 0)")
            name = f"{size[0]}×{size[1]} {step}"
            await d.shot(page, f"phone-{size[1]}-{step}")
            await targets(d, page, name)
            hidden = await page.evaluate("""(() => {
              const bottom = document.querySelector("#actions").getBoundingClientRect().top;
              const inside = (r) => r.top >= 0 && r.bottom <= innerHeight && r.width > 0;
              const names = ["#disk", "#number, #verdict", "#actions"].filter((s) => ![...document.querySelectorAll(s)].some((n) => inside(n.getBoundingClientRect())));
              const images = [...document.querySelectorAll("#images .frame")].filter((n) => n.getBoundingClientRect().bottom > bottom + 1);
              return [...names, ...images.map((n) => n.closest("figure").dataset.role)];
            })()""")
            d.check(f"{name}: cameras, disk and answers without scrolling", not hidden, hidden)
        await d.go_to(page, "initial")
        await page.context.close()


async def gels(d, context):
    """Raw image and difference of a gel: both, or the one that a tap chooses, remembered."""
    page = await d.page(context)
    await d.go_to(page, "grasp")
    frame = page.locator("#images figure[data-role=left] .frame")
    await true(page, "document.querySelector('#images figure[data-role=left] img').naturalWidth === 640")
    d.check("raw image and difference arrive as one image", True)
    if d.server.mock:
        left, right = [await page.locator(f"figure[data-role={role}] .health").inner_text() for role in ("left", "right")]
        d.check("the shear of a gel is told", "shear 0.42 mm ↗ slip 12 %" in left, left)
        d.check("or why there is none", "blurred" in right and "shear" not in right, right)
    seen = []
    for _ in range(3):
        seen.append([await page.locator("#images").get_attribute("data-gels"), await page.locator("figure[data-role=left] .half:visible").all_inner_texts()])
        await frame.click()
    wanted = [["both", ["raw", "difference"]], ["difference", ["difference"]], ["raw", ["raw"]]]
    d.check("a tap on a gel changes the view", seen == wanted, seen)
    await frame.click()
    await page.reload()
    await page.locator("#images[data-gels=difference]").wait_for()
    d.check("the view is remembered", True)
    await page.evaluate("localStorage.removeItem('gripcast-gels')")
    await page.close()


async def recent(d, context):
    """Looks back over the last seconds; a step returns to the live images."""
    page = await d.page(context)
    await d.go_to(page, "initial")
    await true(page, "[...document.querySelectorAll('#images img:not(.earlier)')].every((i) => i.naturalWidth > 0)")
    await page.wait_for_timeout(3000)
    await page.locator("#moment").evaluate("(n) => { n.value = '-10'; n.dispatchEvent(new Event('input')); }")
    await page.locator("#images.past").wait_for()
    words = await page.locator("#moment-words").inner_text()
    d.check("the slider shows an earlier moment and says which", words.endswith("s back") and 1 <= float(words.split()[0]) <= 5, words)
    await true(page, "[...document.querySelectorAll('#images .earlier')].every((i) => i.naturalWidth > 0)")
    d.check("of every camera", True)
    await d.shot(page, "recent")
    await d.advance(page, "grasp", lambda: page.keyboard.press("Space"))
    await page.locator("#images:not(.past)").wait_for()
    d.check("a step returns to the live images", await page.locator("#moment-words").inner_text() == "live")
    await page.locator("#images figure[data-role=right] .frame").click()
    await d.advance(page, "label", lambda: page.keyboard.press("Space"))
    d.check("a tap on an image does not take the pedal's space", True)
    await page.evaluate("localStorage.removeItem('gripcast-gels')")
    await page.close()


async def lift(d, context):
    """From the grasp to its label the gauge shows the prediction saved with the grasp."""
    page = await d.page(context)
    small = await d.page(await d.context(PHONE, "dark"))
    await d.go_to(page, "label")
    last = d.server.state()["session"]["last"]
    said = last["predicted"]
    for each, name in ((page, "tablet"), (small, "phone")):
        await each.locator("#actions.labelling").wait_for()
        number, verdict = [await each.locator(s).inner_text() for s in ("#number", "#verdict")]
        if said:
            word = "UNSURE" if (said.get("ood_score") or 0) > 1 else "STABLE" if said["p_stable"] >= said["threshold"] else "SLIP"
            d.check(f"{name}: LIFT shows the grasp's own {number} {verdict}", [number, verdict] == [f"{said['p_stable']:.2f}", word], said)
        else:
            d.check(f"{name}: LIFT says that none was saved", "none was saved with grasp" in verdict, verdict)
        about = await each.locator("#about").inner_text()
        d.check(f"{name}: and of which grasp", not said or last["id"][-4:] in about, about)
        d.check(f"{name}: the trigger is out of the way", await each.locator("#trigger:visible").count() == 0)
    await d.tap(page, "#stable")
    await page.locator("#trigger.initial").wait_for()
    await page.locator("#verdict:not(:has-text('STABLE'))").wait_for()
    d.check("after the label it is gone", True)
    await small.context.close()
    await page.close()


async def themes(d):
    """Sizes and colours on every screen."""
    for name, size, scheme in (("phone-light", PHONE, "light"), ("phone-dark", PHONE, "dark"), ("phone-side", (740, 360), "dark"), ("tablet-light", (1024, 768), "light"), ("tablet-dark", TABLET, "dark"), ("desktop", DESKTOP, "dark")):
        page = await d.page(await d.context(size, scheme))
        await d.go_to(page, "grasp")
        await true(page, "document.querySelectorAll('#images img:not(.earlier)').length > 0 && [...document.querySelectorAll('#images img:not(.earlier)')].every((i) => i.naturalWidth > 0)")
        await page.wait_for_timeout(400)
        await d.shot(page, name)
        await d.quality(page, name)
        await targets(d, page, name)
        if size[0] >= 1024:
            sizes = await page.evaluate("['#number', '#verdict', '#steps .verb', '#steps .here .digit'].map((s) => parseFloat(getComputedStyle(document.querySelector(s)).fontSize))")
            if await page.locator("#gauge.none").count() == 0:
                d.check(f"{name}: digits are {sizes[0]:.0f} px, the word {sizes[1]:.0f} px", sizes[0] >= 120 and sizes[1] >= 100, sizes)
            d.check(f"{name}: the step is {sizes[2]:.0f} px", min(sizes[2:]) >= 80, sizes)
            fits = await page.evaluate("(() => { const m = document.querySelector('#collect'); return m.scrollHeight <= m.clientHeight + 1; })()")
            d.check(f"{name}: all of it without scrolling", fits)
        await page.context.close()
    page = await d.page(await d.context(TABLET, "dark"))
    await page.locator("#theme").click()
    d.check("the switch makes it light", await page.evaluate("document.documentElement.dataset.theme") == "light")
    await page.reload()
    d.check("and it stays so", await page.evaluate("document.documentElement.dataset.theme") == "light")
    await page.context.close()


async def troubles(d):
    """What only the mock can be told to do."""
    page = await d.page(await d.context(TABLET, "dark"))
    small = await d.page(await d.context(PHONE, "light"))
    d.server.order(fault={"role": "left", "state": "silent"})
    await page.locator("#fault.large").wait_for()
    text = await page.locator("#fault").inner_text()
    wanted = ["LEFT GELSIGHT", "SILENT", "GelSight Mini", "2BNN4ZE7", "3-2.1", "REPLUG"]
    d.check("a fault names camera, product, serial, port and remedy", all(w in text for w in wanted), text)
    await d.quality(page, "fault")
    await d.shot(page, "fault")
    await d.shot(small, "phone-fault")
    await d.quality(small, "fault on a phone")
    await page.keyboard.press("Escape")
    await page.locator("#fault:not(.large)").wait_for()
    await d.shot(page, "fault-small")
    await d.legible(page, "small fault")
    d.check("Esc minimises the fault on this page only", await small.locator("#fault.large").count() == 1)
    d.server.order(fault={"role": "rgb", "state": "unplugged"})
    await page.locator("#fault.large >> text=PLUG IT IN").wait_for()
    d.check("another fault is large again", True)
    d.server.order(fault={"role": "right", "state": "damaged"})
    await page.locator("#fault.large >> text=DAMAGED 87 %").wait_for()
    text = await page.locator("#fault").inner_text()
    d.check("a damaged camera is not told to be plugged in", "PLUG IT IN" not in text and "the JPEG is truncated" in text, text)
    d.server.order(fault=None)
    await page.locator("#fault").wait_for(state="hidden")
    d.check("the banner closes by itself", True)

    await d.go_to(page, "grasp")
    d.server.order(refuse="overridable", p=0.83)
    await d.tap(page, "#trigger")
    await page.locator("#refusal >> text=no contact").wait_for()
    await small.locator("#refusal >> text=no contact").wait_for()
    d.check("both pages show the reason", True)
    for each, name in ((page, "tablet"), (small, "phone")):
        first = each.locator("#refusal .reason")
        size = await first.evaluate("(n) => parseFloat(getComputedStyle(n).fontSize)")
        rest = await each.locator("#refusal li").first.evaluate("(n) => parseFloat(getComputedStyle(n).fontSize)")
        d.check(f"{name}: the first reason is the largest, {size:.0f} px against {rest:.0f}", size >= 1.2 * rest and "newest good frame" in await first.inner_text())
        words = await each.locator("#refusal").inner_text()
        d.check(f"{name}: the words are those of the buttons", "“Grasp”" in words and "“Override”" in words, words)
    await d.shot(page, "refusal")
    await d.shot(small, "phone-refusal")
    await d.quality(page, "refusal")
    d.check("the refusal is read out", "no contact" in await page.locator("#assertive").inner_text())
    await d.tap(page, "#override")
    await page.locator("#actions.labelling").wait_for()
    d.check("take it anyway", True)
    d.server.order(refuse=None)
    await d.tap(page, "#slip")
    await page.locator("#trigger.initial").wait_for()

    d.server.order(saving_s=1.5)
    await asyncio.sleep(0.4)  # longer than a double tap, see Driver.tap
    await page.locator("#trigger:not([aria-disabled])").dblclick()
    await small.locator("#steps .saving").wait_for()
    d.check("saving disables the other page too", await small.locator("#trigger").get_attribute("aria-disabled") == "true")
    await d.shot(page, "saving")
    await page.locator("#trigger.grasp:not([aria-disabled])").wait_for()
    await asyncio.sleep(0.3)
    d.check("a double tap is one step", d.server.state()["session"]["step"] == "grasp" and not d.server.state()["session"]["saving"])
    d.server.order(saving_s=0.1, fail=True)
    await d.tap(page, "#trigger")
    await page.locator("#message.error").wait_for()
    d.check("a failed save is reported", "NOT saved" in await page.locator("#message").inner_text())
    await d.shot(page, "failed-save")
    d.server.order(fail=False, stale=True)
    await page.locator("#gauge.old #verdict:text-is('OLD')").wait_for()
    d.check("a stale prediction is OLD", True)
    await d.shot(page, "stale")
    d.server.order(stale=False, ood_score=1.7)
    await page.locator("#gauge.unsure #verdict:text-is('UNSURE')").wait_for()
    await d.shot(page, "unsure")
    await small.locator("#gauge.unsure").wait_for()
    await d.shot(small, "phone-unsure")
    await d.quality(page, "unsure")
    await d.quality(small, "unsure on a phone")
    d.server.order(ood_score=0.4, heuristic=True, p=0.2)
    await page.locator("#heuristic:visible").wait_for()
    await page.locator("#gauge.slip #verdict:text-is('SLIP')").wait_for()
    d.check("a heuristic is named as one", True)
    await d.shot(page, "slip-heuristic")
    d.server.order(heuristic=False, absent="the model needs a colour camera, and the rig has none")
    await page.locator("#verdict >> text=no prediction: the model needs").wait_for()
    d.check("a missing prediction has a reason", True)
    await d.shot(page, "absent")
    await d.shot(small, "phone-absent")
    d.server.order(absent=None, mute=True)
    await page.locator("#verdict >> text=no data").wait_for()
    d.check("silence of the server is not a prediction", True)
    # It reconnects after 0.4 s, and is silent again.
    await page.locator("#link:has-text('saved grasps are safe')").wait_for(timeout=15000)
    d.check("a lost connection is detected", True)
    d.server.order(mute=False, p=None)
    await page.locator("body:not(.offline)").wait_for(timeout=20000)
    await page.context.close()
    await small.context.close()


async def cable(d, context):
    """A virtual camera is unplugged and replugged, seen on two pages."""
    page = await d.page(context)
    other = await d.page(await d.context(PHONE, "light"))
    await d.go_to(page, "initial")
    d.server.unplug("left")
    for each in (page, other):
        await each.locator("#fault.large").wait_for(timeout=20000)
    text = await page.locator("#fault").inner_text()
    d.check("an unplugged camera is named with its serial", "LEFT GELSIGHT" in text and "VIRT-LEFT" in text, text)
    await d.shot(page, "cable")
    answer = d.server.call("/api/commands", "POST", {"command": "trigger"})
    reasons = json.dumps(answer.get("reasons"))
    d.check("capture is refused without the camera", answer["result"] == "refused" and "left" in reasons, answer)
    back = time.monotonic()
    d.server.unplug()
    for each in (page, other):
        await each.locator("#fault").wait_for(state="hidden", timeout=20000)
    d.check(f"the page shows it back ({time.monotonic() - back:.2f} s)", True)
    await true(page, "[...document.querySelectorAll('#images img:not(.earlier)')].every((i) => i.naturalWidth > 0)")
    await d.advance(page, "grasp", lambda: d.tap(page, "#trigger"))
    await other.context.close()


async def first_state(d):
    """Without its scripts the page is not connected, and its buttons are off."""
    page = await (await d.context(PHONE, java_script_enabled=False)).new_page()
    await page.goto(d.server.url)
    d.check("without scripts: “Not connected”", "Not connected" in await page.locator("#link").inner_text())
    enabled = await page.locator("#actions button:not([disabled])").count()
    d.check("without scripts: no button is enabled", enabled == 0, enabled)
    await d.shot(page, "first-state")
    await page.context.close()


async def proxies(d):
    """The page behind proxies that replace headers, block the WebSocket or have a path."""
    port = int(d.server.url.rsplit(":", 1)[1])
    cases = {
        "plain proxy": ({}, "/"),
        "with Host": ({"host": True}, "/"),
        "with Host and Upgrade": ({"host": True, "upgrade": True}, "/"),
        "below a path": ({"host": True, "upgrade": True, "prefix": "/rig1/"}, "/rig1/"),
    }
    if not d.server.mock:
        cases["below a path without slash"] = ({"host": True, "upgrade": True, "prefix": "/rig2"}, "/rig2")
        cases["plain, below a path without slash"] = ({"prefix": "/rig2"}, "/rig2")
    for name, (settings, path) in cases.items():
        async with Proxy(port, **settings) as proxy:
            for size_name, size in (("phone", PHONE), ("desktop", DESKTOP)):
                what = f"{name}, {size_name}"
                d.server.call("/api/commands", "POST", {"command": "undo"}) if d.step() != "initial" else None
                await d.go_to(None, "initial")
                page = await d.page(await d.context(size), path, proxy.url)
                banner = await page.locator("#link").inner_text()
                blocked = not settings.get("upgrade")
                d.check(f"{what}: {'the blocked WebSocket is named' if blocked else 'no banner'}", ("WebSocket blocked" in banner) == blocked, banner)
                await true(page, "document.querySelectorAll('#images img:not(.earlier)').length > 0 && [...document.querySelectorAll('#images img:not(.earlier)')].every((i) => i.naturalWidth > 0)")
                d.check(f"{what}: images", True)
                await d.advance(page, "grasp", page.locator("#trigger").click)
                await d.tap(page, "#undo")
                await d.until(f"{what}: undo", lambda: d.step() == "initial")
                await d.shot(page, f"proxy-{what.replace(' ', '-').replace(',', '')}")
                await page.context.close()


async def dead_line(d):
    """The line dies between a tap and its answer; all connections stay open."""
    port = int(d.server.url.rsplit(":", 1)[1])
    for name, size in (("phone", PHONE), ("desktop", DESKTOP)):
        await d.go_to(None, "initial")
        async with Proxy(port, host=True, upgrade=True) as proxy:
            page = await d.page(await d.context(size), "/", proxy.url)
            toasts = page.locator("#toasts")
            await page.locator("#trigger:not([aria-disabled])").wait_for()
            # The tap does not arrive.
            proxy.dead_up = proxy.dead_down = True
            await page.locator("#trigger").click()
            d.check(f"{name}: the tap is shown at once", await page.locator("#trigger[aria-busy=true]").count() == 1)
            await page.locator("#trigger[aria-disabled=true]:not([aria-busy])").wait_for(timeout=15000)
            await page.locator("#toasts >> text=not known whether").wait_for()
            d.check(f"{name}: no answer is said", True)
            await d.shot(page, f"dead-line-{name}")
            await page.locator("#trigger").click(force=True)
            await page.locator("#toasts >> text=not sent").wait_for()
            d.check(f"{name}: a tap on the dead line is not sent", True)
            proxy.dead_up = proxy.dead_down = False
            await page.locator("body:not(.offline)").wait_for(timeout=20000)
            await page.locator("#trigger:not([aria-disabled])").wait_for()
            await asyncio.sleep(1)
            session = d.server.state()["session"]
            d.check(f"{name}: the old tap is not carried out", session["step"] == "initial" and session["initial_at"] is None, session)
            # The tap arrives, its answer does not.
            for _ in range(30):
                proxy.dead_down = True
                await page.locator("#trigger").click()
                await asyncio.sleep(1)
                session = d.server.state()["session"]
                if session["step"] == "grasp":
                    break
                proxy.dead_down = False
                await page.locator("#trigger:not([aria-disabled])").wait_for()
            d.check(f"{name}: the tap is carried out", session["step"] == "grasp")
            await page.locator("#toasts >> text=not known whether").wait_for(timeout=15000)
            proxy.dead_down = False
            await page.locator("#toasts >> text=carried out; the answer was late").wait_for(timeout=20000)
            d.check(f"{name}: the result is asked for after the reconnection", d.step() == "grasp")
            await page.locator("#trigger.grasp").wait_for()
            d.check(f"{name}: no text about an old tap remains in doubt", "not known" not in await toasts.inner_text())
            await page.context.close()
        d.server.call("/api/commands", "POST", {"command": "undo"})


async def held_key(d, context):
    """A key that is held, with and without the browser's mark, is one press."""
    page = await d.page(context)
    await d.go_to(page, "initial")
    sent = []
    page.on("request", lambda request: sent.append(request.post_data) if request.url.endswith("/api/commands") else None)
    await page.keyboard.down("u")
    for _ in range(10):
        await page.keyboard.down("u")
    await page.keyboard.up("u")
    await asyncio.sleep(0.5)
    # A remote desktop sends pairs of press and release every 30 ms, without a mark.
    await page.evaluate("""async () => {
      for (let i = 0; i < 15; i += 1) {
        for (const type of ["keydown", "keyup"]) document.body.dispatchEvent(new KeyboardEvent(type, { key: "u", bubbles: true }));
        await new Promise((resolve) => setTimeout(resolve, 30));
      }
    }""")
    await asyncio.sleep(0.5)
    d.check("a held key is one press", len(sent) == 2, sent)
    carried = [json.loads(each)["sender"] for each in sent]
    d.check("a command carries id, age and state", all(each["request_id"] and each["age_ms"] >= 0 and each["sent_at_ms"] > 0 and each["seen"]["revision"] for each in carried), carried)
    await page.close()


async def grasps(d, context):
    """Three grasps by buttons, nothing else."""
    page = await d.page(context)
    await d.go_to(page, "initial")
    before = d.server.state()["session"]["counts"]
    for outcome in ("stable", "slip", "stable"):
        await d.advance(page, "grasp", lambda: d.tap(page, "#trigger"))
        await d.advance(page, "label", lambda: d.tap(page, "#trigger"))
        await d.tap(page, f"#{outcome}")
        await page.locator("#trigger.initial").wait_for()
    after = d.server.state()["session"]["counts"]
    found = {name: after[name] - before[name] for name in ("stable", "slip")}
    d.check("three grasps are counted", found == {"stable": 2, "slip": 1}, found)
    await d.shot(page, "three-grasps")


async def restart(d, context):
    """The server stops, with and without a shutdown event, and restarts."""
    page = await d.page(context)
    for how, words in ((signal.SIGTERM, "has stopped"), (signal.SIGKILL, "saved grasps are safe")):
        d.server.stop(how)
        await page.locator("#link:visible").wait_for(timeout=20000)
        text = await page.locator("#link").inner_text()
        d.check(f"{how.name}: “{words}”", words in text, text)
        d.check(f"{how.name}: no buttons, no prediction", await page.locator("#trigger").get_attribute("aria-disabled") == "true" and await page.locator("#gauge.none").count() == 1)
        if how == signal.SIGTERM:
            await d.shot(page, "lost")
            await d.legible(page, "lost")
        await d.server.start()
        if d.server.token and not d.server.mock:
            # Sessions end with the daemon.
            await page.locator("#token").fill(d.server.token, timeout=30000)
            await page.keyboard.press("Enter")
            await page.locator("#steps .here").wait_for()
        await page.locator("#link").wait_for(state="hidden", timeout=30000)
        await true(page, "[...document.querySelectorAll('#images img:not(.earlier)')].every((i) => i.naturalWidth > 0)")
        d.check(f"{how.name}: back with images", await page.locator("#trigger[aria-disabled]").count() == 0)
    await page.close()


async def login(d, options):
    """The form, a wrong token, the right one, and one in the address."""
    server = d.server
    if d.server.mock:
        server = Server(options, token="open-sesame")
        await server.start()
    context = await d.context(PHONE, "light")
    page = await context.new_page()
    page.on("console", d.listen)
    await page.goto(server.url)
    await page.locator("#login:visible").wait_for()
    d.check("a token is asked for, and nothing else is shown", await page.locator("#actions:visible, #collect:visible").count() == 0)
    await d.shot(page, "login")
    await d.quality(page, "login")
    await page.locator("#token").fill("wrong")
    await page.keyboard.press("Enter")
    await page.locator("#login-fault:not(:empty)").wait_for()
    await d.shot(page, "login-wrong")
    await page.locator("#token").fill(server.token)
    await page.keyboard.press("Enter")
    await page.locator("#steps .here").wait_for()
    d.check("the token opens the page", await page.locator("#login:visible").count() == 0)
    await context.close()
    context = await d.context()
    page = await context.new_page()
    await page.goto(f"{server.url}/#token={server.token}")
    await page.locator("#steps .here").wait_for()
    d.check("a token in the address opens it and is taken out", "token" not in page.url)
    await page.locator("#show-keys").click()
    await page.locator("#logout").click()
    await page.locator("#login:visible").wait_for()
    await page.reload()
    await page.locator("#login:visible").wait_for()
    d.check("after a logout a token is asked for", await page.locator("#collect:visible").count() == 0)
    await context.close()
    if server is not d.server:
        server.stop()


async def run(options):
    shots = pathlib.Path(options.shots) if options.shots else None
    if shots:
        shots.mkdir(parents=True, exist_ok=True)
    server = Server(options)
    await server.start()
    async with async_playwright() as playwright:
        chromium = options.chromium or next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
        browser = await playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--autoplay-policy=user-gesture-required"]
        )
        d = Driver(browser, server, shots)
        context = await d.context()
        parts = {
            "cycle": lambda: cycle(d, context),
            "keyboard": lambda: keyboard(d, context),
            "gallery": lambda: gallery(d, context),
            "images": lambda: images(d, context),
            "sound": lambda: sound(d),
            "themes": lambda: themes(d),
            "first_screen": lambda: first_screen(d),
            "gels": lambda: gels(d, context),
            "recent": lambda: recent(d, context),
            "lift": lambda: lift(d, context),
            "grasps": lambda: grasps(d, context),
            "first_state": lambda: first_state(d),
            "held_key": lambda: held_key(d, context),
            "proxies": lambda: proxies(d),
            "dead_line": lambda: dead_line(d),
            "cable": (lambda: cable(d, context)) if server.unplugged else None,
            "troubles": (lambda: troubles(d)) if server.mock else None,
            "restart": (lambda: restart(d, context)) if server.restartable else None,
            "login": (lambda: login(d, options)) if server.mock or server.token else None,
        }
        for name, part in parts.items():
            if options.only and name not in options.only.split(","):
                continue
            if part is None:
                print(f"SKIPPED {name}: not possible with this server", flush=True)
                continue
            try:
                await part()
            except Exception:
                traceback.print_exc()
                d.check(f"{name} runs to its end", False)
                for index, each in enumerate(page for c in browser.contexts for page in c.pages):
                    await d.shot(each, f"failed-{name}-{index}")
            for each in [page for c in browser.contexts for page in c.pages]:
                violations = await each.evaluate("window.seen?.policy ?? []")
                d.check(f"{name}: no breach of the content security policy", not violations, violations)
                await each.close()
        d.check("no errors on the console", not d.noise, d.noise[:5])
        await browser.close()
    server.stop()
    print(f"{d.passed} checks passed, {len(d.failed)} failed")
    return 1 if d.failed else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--url", help="of a server that runs")
    parser.add_argument("--serve", help="command that serves at {port}")
    parser.add_argument("--token")
    parser.add_argument("--shots", help="directory for images of the page")
    parser.add_argument("--only", help="parts, separated by commas")
    parser.add_argument("--chromium", help="the browser's program")
    options = parser.parse_args()
    sys.exit(asyncio.run(run(options)))


if __name__ == "__main__":
    main()
