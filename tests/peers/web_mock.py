"""A gripcast daemon without gripcast: serves the page and a made-up session behind its API.

    python3 -m venv venv && venv/bin/pip install aiohttp numpy pillow
    venv/bin/python tests/peers/web_mock.py --port 8765 [--token T] [--grasps 30] [--cameras 4]

For work on the page (src/web/page), which is read anew for every request. Ctrl-C says goodbye to
the pages first. Beyond the API, `POST /mock` with JSON changes what is simulated: `fault` (role and
state, or null), `stale`, `absent` (a reason or null), `heuristic`, `ood_score`, `p` (fixed, or null to
wander), `refuse` (`overridable`, `final` or null), `saving_s`, `fail`, `mute` (no events).
"""

import argparse
import asyncio
import base64
import contextlib
import datetime
import hashlib
import io
import math
import pathlib
import random
import re
import time

import numpy
from aiohttp import WSMsgType, web
from PIL import Image

PAGE = pathlib.Path(__file__).resolve().parents[2] / "src/web/page"
# The page has one inline script.
INLINE = re.search(r"<script>(.*?)</script>", (PAGE / "index.html").read_text(), re.DOTALL)[1]
HASH = base64.b64encode(hashlib.sha256(INLINE.encode()).digest()).decode()
POLICY = (
    f"default-src 'none'; script-src 'self' 'sha256-{HASH}'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
IDENTITIES = {
    "left": ("GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7", "3-2.1", 25.0),
    "right": ("GelSight Mini R0B 2BNK-9QX2", "2BNK9QX2", "3-2.2", 25.0),
    "rgb": ("Intel RealSense D435 RGB", "838212073252", "4-1", 30.0),
    "depth": ("Intel RealSense D435 Depth", "838212073252", "4-1", 30.0),
    "external": ("Logitech BRIO", "4A1C33F0", "3-4", 10.0),
}
OBJECTS = ["mug", "screwdriver", "bottle", "<b>sponge</b> & co", "a very long name of an object that nobody would want to type"]
WORDS = {
    "trigger", "initial", "grasp", "override", "undo", "redo", "stable", "slip", "unlabel", "relabel",
}  # fmt: skip
Y, X = numpy.mgrid[0:240, 0:320].astype(numpy.float32)


def jpeg(pixels):
    out = io.BytesIO()
    Image.fromarray(pixels.clip(0, 255).astype(numpy.uint8)).save(out, "JPEG", quality=80)
    return out.getvalue()


def gel(seed, contact):
    """A gel: its lights, and a press of an object that depends on the seed."""
    rng = random.Random(seed)
    lights = numpy.stack([110 + 50 * (X / 320), 120 + 30 * (Y / 240), 150 - 50 * (X / 320)], axis=2)
    cx, cy, a = rng.uniform(110, 210), rng.uniform(90, 150), rng.uniform(0, math.pi)
    u = (X - cx) * math.cos(a) + (Y - cy) * math.sin(a)
    v = -(X - cx) * math.sin(a) + (Y - cy) * math.cos(a)
    bump = numpy.exp(-((u / rng.uniform(40, 110)) ** 4) - (v / rng.uniform(20, 50)) ** 4)
    dy, dx = numpy.gradient(bump)
    return lights + contact * numpy.stack([2600 * dx, 2600 * dy, -2600 * dx - 700 * dy], axis=2)


def scene(seed, closed, depth=False):
    """What the camera between the fingers sees."""
    rng = random.Random(seed)
    out = numpy.zeros((240, 320, 3), numpy.float32) + (166, 138, 104)
    out += 14 * numpy.sin(X / 9 + 3 * numpy.sin(Y / 21))[..., None]
    colour = numpy.array([rng.uniform(40, 220) for _ in range(3)])
    body = ((X - 160) / rng.uniform(30, 55)) ** 4 + ((Y - 120) / rng.uniform(50, 90)) ** 4 < 1
    out[body] = colour * (0.6 + 0.4 * (X[body] / 320))[..., None]
    gap = 62 if closed else 100
    for side in (-1, 1):
        finger = (side * (X - 160) > gap - Y * 0.08) & (side * (X - 160) < gap + 60) & (Y > 70)
        out[finger] = (38, 40, 46)
    if not depth:
        return out
    far = numpy.where(out[..., 0] == 38, 0.12, numpy.where(body, 0.3, 0.5 + 0.2 * (Y / 240)))
    stripes = numpy.where(((X + Y) // 4) % 2 > 0, 96, 40)[..., None]
    shadow = (abs(X - 70) < 12) & (Y > 40)
    return numpy.where(shadow[..., None], stripes, turbo(far))


def image(role, stage, seed, contact=1.0):
    if role in ("left", "right"):
        seed = f"{seed}{role}"
        if stage == "difference":
            return jpeg(gel(seed, contact) - gel(seed, 0) + 128)
        return jpeg(gel(seed, 0 if stage == "initial" else contact))
    return jpeg(scene(seed, stage != "initial", role == "depth"))


def shear(mean_displacement_mm, slip_ratio):
    summary = {"source": "markers", "confidence": 0.9, "tracked_fraction": 1.0, "mean_displacement_mm": mean_displacement_mm, "max_displacement_mm": 1.0, "divergence": 0.0, "curl": 0.0, "contact_fraction": 0.2, "slip_ratio": slip_ratio}
    return {"summary": summary, "messages": []}


def both(seed, contact, closed):
    """Raw image and difference of a gel side by side; dark in place of the difference without an initial frame."""
    raw = gel(seed, contact)
    right = raw - gel(seed, 0) + 128 if closed else numpy.full_like(raw, 24)
    return jpeg(numpy.concatenate([raw, right], axis=1))


def turbo(fraction):
    """The colours of gripcast's depth images."""
    coefficients = [
        (0.1357214, 4.6153926, -42.66032, 132.13108, -152.9424, 59.28638),
        (0.0914026, 2.1941884, 4.8429666, -14.185033, 4.2772986, 2.829566),
        (0.1066733, 12.641946, -60.58205, 110.36277, -89.90311, 27.34825),
    ]
    return 255 * numpy.stack([sum(c * fraction**n for n, c in enumerate(each)) for each in coefficients], axis=2)


class Mock:
    def __init__(self, options):
        self.options = options
        self.roles = list(IDENTITIES)[: options.cameras]
        self.started = time.monotonic()
        self.random = random.Random(7)
        self.sockets = set()
        self.control = {
            "fault": None, "stale": False, "absent": None, "heuristic": False, "ood_score": 0.4,
            "p": None, "refuse": None, "saving_s": 0.15, "fail": False, "mute": False, "free": 7.0e10,
        }  # fmt: skip
        self.names = {"object": "mug", "scene": "desk", "operator": "ada"}
        self.pending = None
        self.last = None
        self.undos, self.redos = [], []
        self.message = self.refusal = None
        self.saving = False
        self.revision = int(1000 * time.time())
        self.answers = {}
        self.trash = {}
        self.grasps = {}
        now = datetime.datetime.now(datetime.timezone.utc)
        for index in range(options.grasps):
            self.new_grasp(now - datetime.timedelta(minutes=3 * (options.grasps - index)), index)

    def new_grasp(self, at, index=None):
        rng = self.random
        p = rng.betavariate(0.6, 0.5)
        old = index is not None
        key = f"{at:%Y-%m-%dT%H-%M-%SZ}-{rng.randrange(65536):04x}"
        outcome = "unlabelled"
        if old and index % 11:
            outcome = "stable" if rng.random() < 0.15 + 0.7 * p else "slip"
        grasp = {
            "schema": 1, "id": key, "software": "mock", "rig": "virtual", "note": "",
            **(self.names if not old else {"object": OBJECTS[index // 4 % 5], "scene": "desk", "operator": "ada"}),
            "outcome": outcome, "labelled_at": stamp(at) if outcome != "unlabelled" else None,
            "overridden_guards": [], "pose": None,
            "prediction": {"p_stable": p, "threshold": 0.51, "model": "gripcast-vt", "model_sha256": "0" * 64,
                           "latency_ms": 17.0, "engine_ms": 7.0} if not old or index % 7 else None,
        }  # fmt: skip
        for stage, back_s in (("initial", 4), ("grasp", 0)):
            grasp[stage] = {
                "captured_at": stamp(at - datetime.timedelta(seconds=back_s)), "skew_ms": 21.0, "trigger": "keyboard",
                "cameras": {r: {"file": f"{stage}.{r}.jpg"} for r in self.roles if r != "depth" or stage == "grasp"},
            }  # fmt: skip
        self.grasps[key] = grasp
        return grasp

    # The session.

    def step(self):
        if self.pending:
            return "grasp"
        return "label" if self.last in self.grasps and self.grasps[self.last]["outcome"] == "unlabelled" else "initial"

    def counts(self):
        counts = dict.fromkeys(("stable", "slip", "unlabelled", "object_stable", "object_slip"), 0)
        for grasp in self.grasps.values():
            counts[grasp["outcome"]] += 1
            if grasp["object"] == self.names["object"] and grasp["outcome"] != "unlabelled":
                counts[f"object_{grasp['outcome']}"] += 1
        return counts

    def camera(self, role):
        product, serial, port, fps = IDENTITIES[role]
        fault = self.control["fault"] if (self.control["fault"] or {}).get("role") == role else None
        age = 8 + 10 * (1 + math.sin(7 * time.monotonic() + len(role)))
        t = time.monotonic() - self.started
        return {
            "role": role, "product": product, "serial": serial, "port": port,
            "state": fault["state"] if fault else "live",
            **({"for_s": round(t % 60, 1)} if fault and fault["state"] in ("silent", "frozen") else {}),
            **({"fraction": 0.87, "reason": "the JPEG is truncated"} if fault and fault["state"] == "damaged" else {}),
            **({"reason": "no device with this serial is plugged in"} if fault and fault["state"] == "unplugged" else {}),
            "measured_fps": 0.0 if fault else round(fps - 0.4 * (1 + math.sin(t)), 1), "nominal_fps": fps,
            "frame_age_ms": None if fault else round(age, 1), "received": int(t * fps),
            "sequence_gaps": 6 if role == "left" else 0, "damaged": 0, "late": 0, "reconnects": 0,
            "markers": {"ok": True, "text": "7 tags, pose"} if role == "external" else None,
        }  # fmt: skip

    def prediction(self):
        c = self.control
        if c["absent"] or c["fault"]:
            return None, c["absent"] or f"{c['fault']['role']}: {c['fault']['state']}"
        if not self.pending and c["p"] is None:
            return None, "take the initial frame first"
        p = c["p"] if c["p"] is not None else 0.5 + 0.49 * math.sin((time.monotonic() - self.started) / 2)
        verdict = "unsure" if (c["ood_score"] or 0) > 1 else "stable" if p >= 0.51 else "slip"
        return {
            "p_stable": p, "verdict": verdict, "ood_score": c["ood_score"], "threshold": 0.51,
            "model": "baseline-contact" if c["heuristic"] else "gripcast-vt", "model_sha256": "0" * 64, "heuristic": c["heuristic"],
            "frame_age_ms": 1400.0 if c["stale"] else 30.0 + 20 * self.random.random(), "latency_ms": 17.0, "engine_ms": 7.3,
        }, None  # fmt: skip

    def state(self):
        prediction, absent = self.prediction()
        last = self.grasps.get(self.last)
        return {
            "monotonic_ms": int(1000 * time.monotonic()), "dataset": "demo", "rig": "virtual", "clock": time.strftime("%H:%M:%S"), "disk_free_bytes": self.control["free"],
            "grasps_left": int((self.control["free"] - 1e9) / 1.3e6) if self.grasps else None, "target_per_object": 20,
            "session": {
                "revision": self.revision, "step": self.step(), **self.names,
                "initial_at": self.pending and stamp(self.pending[1]),
                "initial_age_s": self.pending and time.monotonic() - self.pending[2],
                "counts": self.counts(),
                "last": last and {"id": last["id"], "object": last["object"], "outcome": last["outcome"],
                                  "predicted": last["prediction"]},
                "undo": self.undos[-1][0] if self.undos else None,
                "redo": self.redos[-1][0] if self.redos else None,
                "message": self.message, "refusal": self.refusal, "saving": self.saving,
            },
            "cameras": [self.camera(role) for role in self.roles],
            "prediction": prediction, "no_prediction_reason": absent, "contact": {"left": 26.8, "right": 26.8} if self.pending else {},
            "shear": {"left": shear([0.3, -0.3], 0.12), "right": {"summary": None, "messages": ["the image is blurred: check the focus of the sensor and its exposure time"]}} if self.pending else {},
        }  # fmt: skip

    def say(self, text, level="info"):
        self.message = {"level": level, "text": text}

    async def carry_out(self, text):
        """Carries out a command; returns whether, and the reasons if not."""
        if self.saving:
            return False, ["a save is under way"]
        word, _, name = text.partition(" ")
        self.revision += 1
        refused, self.refusal, self.message = self.refusal, None, None
        if word in self.names:
            if not name.strip():
                return False, [f"`{text}` is no command"]
            self.names[word] = name.strip()
            self.say(f"{word}: {self.names[word]}")
            return True, []
        if word == "trigger" and self.step() == "label":
            return await self.nothing("lift, then label the grasp: s stable, f slip")
        if word in ("trigger", "initial", "grasp"):
            return await self.capture(self.step() if word == "trigger" else word, False)
        if word == "override":
            if not refused:
                return await self.nothing("nothing to override")
            return await self.capture(refused["stage"], True)
        if word in ("undo", "redo"):
            stack, other = (self.undos, self.redos) if word == "undo" else (self.redos, self.undos)
            if not stack:
                return await self.nothing(f"nothing to {word}")
            entry = stack.pop()
            await self.save()
            entry[1 if word == "undo" else 2]()
            other.append(entry)
            self.say(f"{entry[0]} {'undone' if word == 'undo' else 'redone'}")
            await self.tone("undone")
            return True, []
        key, _, outcome = name.partition(" ") if word == "relabel" else (self.last, "", word)
        outcome = "unlabelled" if outcome == "unlabel" else outcome
        grasp = self.grasps.get(key)
        if not grasp or grasp["outcome"] == outcome:
            return await self.nothing("no grasp to label yet" if not grasp else f"grasp {grasp['id'][-4:]} is already labelled {outcome}")
        await self.save()
        self.relabel(grasp, outcome)
        self.say(f"grasp {grasp['id'][-4:]} labelled {outcome}")
        await self.tone({"unlabelled": "undone"}.get(outcome, outcome))
        return True, []

    def relabel(self, grasp, outcome):
        before = grasp["outcome"]
        self.set_outcome(grasp, outcome)
        self.undos.append((f"label {outcome} of {grasp['id'][-4:]}", lambda: self.set_outcome(grasp, before), lambda: self.set_outcome(grasp, outcome)))
        self.redos.clear()

    def set_outcome(self, grasp, outcome):
        grasp["outcome"] = outcome
        grasp["labelled_at"] = stamp(datetime.datetime.now(datetime.timezone.utc)) if outcome != "unlabelled" else None

    async def nothing(self, why):
        self.say(why)
        await self.tone("refused")
        return False, [why]

    async def save(self):
        self.saving = True
        await self.publish()
        await asyncio.sleep(self.control["saving_s"])
        self.saving = False

    async def capture(self, stage, overriding):
        mode = self.control["refuse"]
        if mode == "final" or (mode == "overridable" and not overriding):
            reasons = ["left: newest good frame is 340 ms old, limit 200 ms", "no contact: at most 0.4 % of a gel changed since the initial frame, limit 2.0 %"]
            self.refusal = {"stage": stage, "reasons": reasons, "can_override": mode == "overridable"}
            await self.tone("refused")
            return False, reasons
        if stage == "grasp" and not self.pending:
            reasons = ["no initial frame: open the gripper and take one"]
            self.refusal = {"stage": stage, "reasons": reasons, "can_override": False}
            await self.tone("refused")
            return False, reasons
        await self.save()
        if self.control["fail"]:
            self.say(f"the {'initial frame' if stage == 'initial' else 'grasp'} was NOT saved: no space left on the disk", "error")
            await self.tone("fault")
            return None, ["no space left on the disk"]
        now = datetime.datetime.now(datetime.timezone.utc)
        if stage == "initial":
            before, self.pending = self.pending, (str(now), now, time.monotonic())
            taken = self.pending
            self.undos.append(("initial frame", lambda: self.set(pending=before), lambda: self.set(pending=taken)))
            self.say("initial frame saved: close the gripper")
            tone = "initial_saved"
        else:
            before, pending, grasp = self.last, self.pending, self.new_grasp(now)
            key = grasp["id"]
            self.set(pending=None, last=key)

            def undo():
                self.grasps.pop(key, None)
                self.set(pending=pending, last=before)

            def redo():
                self.grasps[key] = grasp
                self.set(pending=None, last=key)

            self.undos.append((f"grasp {key[-4:]}", undo, redo))
            self.say(f"grasp {key[-4:]} saved: lift, then label it")
            tone = "grasp_saved"
        self.redos.clear()
        await self.tone(tone)
        return True, []

    def set(self, **fields):
        for name, value in fields.items():
            setattr(self, name, value)

    # Events.

    async def send(self, event):
        if self.control["mute"]:
            return
        for socket in list(self.sockets):
            try:
                await socket.send_json(event)
            except (ConnectionError, RuntimeError):
                self.sockets.discard(socket)

    async def tone(self, tone):
        await self.send({"type": "tone", "tone": tone})

    async def publish(self):
        await self.send({"type": "state", "state": self.state()})

    async def stored(self, key):
        await self.send({"type": "stored", "stored": {"id": key}})

    async def tick(self):
        while True:
            await asyncio.sleep(0.1)
            await self.publish()


def stamp(at):
    return at.strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def error(status, kind, what, remedy=None):
    body = {"error": {"kind": kind, "what": what, "where": None, "remedy": remedy}}
    return web.json_response(body, status=status)


def routes(mock):
    table = web.RouteTableDef()

    def stale(sender):
        """Why a command no longer fits."""
        now, reasons = 1000 * time.monotonic(), []
        age = sender.get("age_ms", 0) + max(0, now - sender.get("sent_at_ms", now))
        if sender.get("seen", {}).get("revision", mock.revision) != mock.revision:
            reasons.append("the step was taken already; look at the step and press again")
        if age > 2000:
            reasons.append(f"this command is {age / 1000:.0f} s old; the limit is 2.0 s")
        return reasons

    async def answered(done, reasons, is_stale=False):
        await mock.publish()
        body = {
            True: {"result": "accepted"},
            False: {"result": "refused", "reasons": reasons,
                    "can_override": bool(mock.refusal and mock.refusal["can_override"]), "stale": is_stale},
            None: {"result": "failed", "error": mock.message and mock.message["text"]},
        }[done] | {"state": mock.state()}  # fmt: skip
        return web.json_response(body, status=200 if done else 500 if done is None else 409)

    @table.get("/api/state")
    async def _(_request):
        return web.json_response(mock.state())

    @table.get("/api/health")
    async def _(_request):
        return web.json_response({"ok": True, "version": "0.0.0-mock", "uptime_s": time.monotonic() - mock.started, "tasks": []})

    @table.post("/api/commands")
    async def _(request):
        body = await request.json()
        text, sender = body["command"], body.get("sender", {})
        if text.split(" ")[0] not in WORDS | set(mock.names):
            return error(400, "usage", f"`{text}` is no command")
        key = sender.get("request_id")
        if key not in mock.answers:
            reasons = stale(sender)
            mock.answers[key] = (False, reasons, True) if reasons else (*await mock.carry_out(text), False)
        done, reasons, is_stale = mock.answers[key] if key else mock.answers.pop(key)
        if done:
            await mock.stored(mock.last)
        return await answered(done, reasons, is_stale)

    @table.get("/api/commands/{id}")
    async def _(request):
        answer = mock.answers.get(request.match_info["id"])
        return await answered(*answer) if answer else error(404, "not_found", "no command with this request id")

    @table.put(r"/api/{field:object|scene|operator}")
    async def _(request):
        name = (await request.json())["name"]
        return await answered(*await mock.carry_out(f"{request.match_info['field']} {name}"))

    @table.get("/api/objects")
    async def _(_request):
        objects = {}
        for grasp in mock.grasps.values():
            objects.setdefault(grasp["object"], dict.fromkeys(("stable", "slip", "unlabelled"), 0))[grasp["outcome"]] += 1
        return web.json_response({"target_per_object": 20, "objects": [{"object": name} | counts for name, counts in sorted(objects.items())]})

    @table.get("/api/grasps")
    async def _(request):
        query = request.query
        found = [summary(g) for _, g in sorted(mock.grasps.items(), reverse=True)]
        for name in ("object", "outcome"):
            if name in query:
                found = [g for g in found if g[name] == query[name]]
        if "since" in query:
            found = [g for g in found if g["captured_at"] >= query["since"]]
        if "until" in query:
            found = [g for g in found if g["captured_at"] < query["until"]]
        if query.get("disagree") == "true":
            found = [g for g in found if g["agrees"] is False]
        if "before" in query:
            found = [g for g in found if g["id"] < query["before"]]
        limit = int(query.get("limit", 24))
        return web.json_response({"grasps": found[:limit], "next": found[limit - 1]["id"] if len(found) > limit else None})

    def wanted(request):
        grasp = mock.grasps.get(request.match_info["id"])
        if not grasp:
            raise web.HTTPNotFound()
        return grasp

    @table.get("/api/grasps/{id}")
    async def _(request):
        return web.json_response(wanted(request))

    @table.get("/api/grasps/{id}/preview/{stage}/{role}.jpg")
    async def _(request):
        info, grasp = request.match_info, wanted(request)
        return web.Response(body=image(info["role"], info["stage"], grasp["id"]), content_type="image/jpeg")

    @table.get("/api/grasps/{id}/files/{stage}.{role}.jpg")
    async def _(request):
        info, grasp = request.match_info, wanted(request)
        return web.Response(body=image(info["role"], info["stage"], grasp["id"]), content_type="image/jpeg")

    @table.patch("/api/grasps/{id}")
    async def _(request):
        grasp, names = wanted(request), await request.json()
        names.pop("sender", None)
        before = {name: grasp[name] for name in names}
        grasp.update(names)
        mock.undos.append((f"names of {grasp['id'][-4:]}", lambda: grasp.update(before), lambda: grasp.update(names)))
        await mock.stored(grasp["id"])
        return await answered(True, [])

    @table.post("/api/grasps/{id}/{what:label|trash|restore}")
    async def _(request):
        key, what = request.match_info["id"], request.match_info["what"]
        if what == "restore":
            if key not in mock.trash:
                return error(404, "missing", f"grasp {key} is not in the trash")
            mock.grasps[key] = mock.trash.pop(key)
        elif what == "trash":
            wanted(request)
            mock.trash[key] = mock.grasps.pop(key)
        else:
            mock.relabel(wanted(request), (await request.json())["outcome"])
        await mock.stored(key)
        return await answered(True, [])

    @table.get("/api/cameras/{role}/preview.{kind:jpg|mjpg}")
    async def _(request):
        role, kind = request.match_info["role"], request.match_info["kind"]
        if kind == "jpg":
            return web.Response(body=live(mock, role), content_type="image/jpeg", headers={"Cache-Control": "no-store"})
        response = web.StreamResponse(headers={"Content-Type": "multipart/x-mixed-replace; boundary=frame", "Cache-Control": "no-store"})
        with contextlib.suppress(ConnectionError):
            await response.prepare(request)
            while True:
                frame = live(mock, role)
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(frame)}\r\n\r\n"
                await response.write(head.encode() + frame + b"\r\n")
                await asyncio.sleep(0.2)
        return response

    @table.get("/api/events")
    async def _(request):
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        mock.sockets.add(socket)
        async for message in socket:
            if message.type is WSMsgType.ERROR:
                break
        mock.sockets.discard(socket)
        return socket

    @table.post("/api/login")
    async def _(request):
        if (await request.json())["token"] != mock.options.token:
            return error(401, "token", "wrong token", "take the one that the daemon printed")
        response = web.json_response({})
        response.set_cookie("gripcast", mock.options.token, httponly=True, samesite="Strict")
        return response

    @table.get("/api/login")
    async def _(request):
        token = mock.options.token
        return web.json_response({"needs_token": bool(token), "logged_in": bool(token) and request.cookies.get("gripcast") == token})

    @table.post("/api/logout")
    async def _(_request):
        response = web.Response(status=204)
        response.del_cookie("gripcast")
        return response

    @table.post("/mock")
    async def _(request):
        mock.control.update(await request.json())
        return web.json_response(mock.control)

    @table.get("/{name:[a-z.]*}")
    async def _(request):
        path = PAGE / (request.match_info["name"] or "index.html")
        if not path.is_file():
            raise web.HTTPNotFound()
        return web.FileResponse(path, headers={"Content-Security-Policy": POLICY, "Cache-Control": "no-store"})

    return table


def live(mock, role):
    """What a camera shows now, gels beside their difference; twenty different images are enough."""
    contact = 1.0 if mock.pending else 0.0
    seed, phase = len(mock.grasps), int(5 * time.monotonic()) % 10
    return frame(role, seed, contact * (0.8 + 0.02 * abs(phase - 5)), bool(mock.pending))


CACHE = {}


def frame(role, seed, contact, closed):
    key = (role, seed, round(contact, 2), closed)
    if key not in CACHE:
        if len(CACHE) > 200:
            CACHE.clear()
        CACHE[key] = both(f"{seed}{role}", contact, closed) if role in ("left", "right") else image(role, "grasp" if closed else "initial", seed, contact)
    return CACHE[key]


def summary(grasp):
    said = grasp["prediction"]
    agrees = None
    if said and grasp["outcome"] != "unlabelled":
        agrees = (said["p_stable"] >= said["threshold"]) == (grasp["outcome"] == "stable")
    return {
        **{name: grasp[name] for name in ("id", "object", "scene", "operator", "outcome", "labelled_at")},
        "captured_at": grasp["grasp"]["captured_at"], "agrees": agrees, "roles": list(grasp["grasp"]["cameras"]),
        "prediction": said,
    }  # fmt: skip


@web.middleware
async def guard(request, handler):
    token = request.app["mock"].options.token
    given = request.cookies.get("gripcast"), request.headers.get("Authorization")
    locked = request.path.startswith("/api/") and request.path != "/api/login"
    if token and locked and token != given[0] and f"Bearer {token}" != given[1]:
        return error(401, "token", "a token is asked for")
    return await handler(request)


async def begin(app):
    app["tick"] = asyncio.create_task(app["mock"].tick())


async def end(app):
    app["tick"].cancel()
    await app["mock"].send({"type": "shutdown"})
    for socket in list(app["mock"].sockets):
        await socket.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=8765)
    parser.add_argument("--token")
    parser.add_argument("--grasps", type=int, default=30)
    parser.add_argument("--cameras", type=int, default=4)
    options = parser.parse_args()
    app = web.Application(middlewares=[guard])
    app["mock"] = Mock(options)
    app.add_routes(routes(app["mock"]))
    app.on_startup.append(begin)
    app.on_shutdown.append(end)
    web.run_app(app, host="127.0.0.1", port=options.port, shutdown_timeout=1, print=None)


if __name__ == "__main__":
    main()
