/** Tones, the same as in the terminal. @import {Tone} from "./types.js" */
import { attribute, byId, say } from "./dom.js";

/** Notes as frequency in Hz (0 is a rest) and duration in ms: rising is good, falling is bad, long
 * and alternating is a fault. @type {Record<Tone, [number, number][]>} */
const MELODIES = {
  initial_saved: [[660, 130]],
  grasp_saved: [[660, 90], [0, 30], [880, 150]],
  stable: [[523, 90], [659, 90], [1047, 200]],
  slip: [[440, 130], [294, 230]],
  undone: [[784, 60], [0, 40], [784, 60], [0, 40], [587, 110]],
  refused: [[196, 140], [0, 60], [196, 140]],
  fault: [[988, 150], [622, 150], [988, 150], [622, 150], [988, 150], [622, 150]],
};
const LOUDNESS = 0.55;
/** Ramps, so that notes do not click, s. */
const RAMP_S = 0.008;
const STORED_AS = "gripcast-sound";

/** @type {AudioContext|null} */
let context = null;
/** @type {PeriodicWave|null} */
let wave = null;
let on = false;

/** Browsers allow sound only after a user gesture. */
function wake() {
  if (!on) return;
  if (!context) {
    context = new AudioContext();
    // Overtones make low notes audible on small loudspeakers.
    wave = context.createPeriodicWave(new Float32Array(4), new Float32Array([0, 0.7, 0.2, 0.1]), {
      disableNormalization: true,
    });
    context.addEventListener("statechange", draw);
  }
  context.resume().then(draw, draw);
}

function draw() {
  const node = byId("sound");
  const sounding = context?.state === "running";
  const word = !on ? "off" : sounding ? "on" : "tap";
  say(node, `♪ ${word}`);
  attribute(node, "aria-label", word === "tap" ? "Sound on after a tap" : `Sound ${word}`);
  attribute(node, "aria-pressed", String(on));
}

/** @param {Tone} tone */
export function play(tone) {
  if (!on || !context || !wave || context.state !== "running") return;
  let at = context.currentTime + 0.01;
  for (const [frequency, ms] of MELODIES[tone] ?? []) {
    const end = at + ms / 1e3;
    if (frequency > 0) note(context, wave, frequency, at, end);
    at = end;
  }
}

/** @param {AudioContext} audio @param {PeriodicWave} shape @param {number} frequency
 * @param {number} start @param {number} end */
function note(audio, shape, frequency, start, end) {
  const source = audio.createOscillator();
  const volume = audio.createGain();
  source.setPeriodicWave(shape);
  source.frequency.value = frequency;
  volume.gain.setValueAtTime(0, start);
  volume.gain.linearRampToValueAtTime(LOUDNESS, start + RAMP_S);
  volume.gain.setValueAtTime(LOUDNESS, end - RAMP_S);
  volume.gain.linearRampToValueAtTime(0, end);
  source.connect(volume).connect(audio.destination);
  source.start(start);
  source.stop(end);
}

/** @param {boolean} wanted */
function remember(wanted) {
  try {
    localStorage.setItem(STORED_AS, wanted ? "on" : "off");
  } catch {
    // Without storage the choice is kept until the page closes.
  }
}

export function startSound() {
  try {
    on = localStorage.getItem(STORED_AS) === "on";
  } catch {
    on = false;
  }
  byId("sound").addEventListener("click", () => {
    const sounding = on && context?.state === "running";
    on = !sounding;
    remember(on);
    if (on) {
      wake();
      context?.resume().then(() => play("initial_saved"));
    } else {
      context?.suspend();
    }
    draw();
  });
  for (const gesture of ["pointerup", "keydown"]) {
    addEventListener(gesture, (event) => {
      if (event.target !== byId("sound") && context?.state !== "running") wake();
    });
  }
  draw();
}
