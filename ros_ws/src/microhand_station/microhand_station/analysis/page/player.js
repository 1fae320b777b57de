// SPDX-License-Identifier: Apache-2.0
// The one time that everything on the page shows, and the slider and button that move it.

const player = {
  time: 0,
  playing: false,
  listeners: [],

  listen(listener) {
    this.listeners.push(listener);
  },

  go(time) {
    this.time = Math.min(Math.max(time, 0), run.duration);
    for (const listener of this.listeners) listener(this.time);
  },

  play(wanted) {
    if (wanted === this.playing) return;
    this.playing = wanted;
    const button = element('play');
    button.classList.toggle('playing', wanted);
    button.setAttribute('aria-label', wanted ? 'Pause' : 'Play');
    if (!wanted) return;
    if (this.time >= run.duration) this.go(0);
    let before = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      const passed = (now - before) / 1000;
      before = now;
      this.go(this.time + passed * Number(element('speed').value));
      if (this.time >= run.duration) this.play(false);
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  },
};

function stepAt(time) {
  let found = null;
  for (const step of run.steps) if (step.begin <= time) found = step;
  return found !== null && time <= found.end + 0.05 ? found : null;
}

function eventAt(time) {
  let found = null;
  for (const event of run.events) if (event.time <= time && (found === null || event.time >= found.time)) found = event;
  return found;
}

function drawStrip() {
  const strip = element('strip');
  const percent = (time) => `${(100 * Math.min(Math.max(time / run.duration, 0), 1)).toFixed(3)}%`;
  for (const step of run.steps) {
    const bar = document.createElement('i');
    bar.className = `bar ${step.kind}`;
    bar.style.left = percent(step.begin);
    bar.style.width = percent(step.end - step.begin);
    bar.title = `${step.number} ${step.what}`;
    strip.append(bar);
  }
  for (const event of run.events) {
    const tick = document.createElement('i');
    tick.className = event.bad ? 'tick bad' : 'tick';
    tick.style.left = percent(event.time);
    strip.append(tick);
  }
}

function startPlayer() {
  const slider = element('slider');
  slider.max = run.duration;
  slider.addEventListener('input', () => {
    player.play(false);
    player.go(Number(slider.value));
  });
  element('play').addEventListener('click', () => player.play(!player.playing));
  document.addEventListener('keydown', (press) => {
    const typing = ['INPUT', 'SELECT', 'BUTTON', 'SUMMARY'].includes(press.target.tagName);
    if (press.code !== 'Space' || typing) return;
    press.preventDefault();
    player.play(!player.playing);
  });
  drawStrip();
  player.listen((time) => {
    slider.value = time;
    slider.setAttribute('aria-valuetext', `${time.toFixed(2)} s`);
    element('clock').textContent = `${time.toFixed(2)} s`;
    const step = stepAt(time);
    element('step-now').textContent = step === null ? '' : `step ${step.number}: ${step.what}`;
    const event = eventAt(time);
    const line = element('event-now');
    line.textContent = event === null ? '' : event.text;
    line.classList.toggle('bad', event !== null && event.bad);
    for (const row of document.querySelectorAll('table.steps tbody tr')) {
      row.classList.toggle('current', step !== null && Number(row.dataset.step) === step.number);
    }
  });
}
