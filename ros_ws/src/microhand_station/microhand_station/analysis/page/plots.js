// SPDX-License-Identifier: Apache-2.0
// One plot per quantity, all over the same time: zoomed together, with the time of the player as a line.

const plots = [];
const PLOT_HEIGHT = 170;

function tableOf(plot) {
  // Each line has its own times; joined, lines bridge the times of others, but not their own gaps.
  const tables = plot.lines.map((line) => [
    Array.from(line.time),
    Array.from(line.values, (value) => (Number.isFinite(value) ? value : null)),
  ]);
  return tables.length === 1 ? tables[0] : libraries.uPlot.join(tables);
}

function seriesOf(line) {
  const colour = colourOf(line.colour);
  const series = { label: line.label, stroke: colour, width: 1.5, points: { show: false }, spanGaps: false };
  if (line.kind === 'wide') Object.assign(series, { width: 5, stroke: `${colour}55` });
  if (line.kind === 'dashed') Object.assign(series, { dash: [5, 4] });
  if (line.kind === 'low' || line.kind === 'high') Object.assign(series, { stroke: `${colour}aa`, width: 1 });
  return series;
}

function valueAt(line, time) {
  const at = lastBefore(line.time, time);
  return at < 0 || time - line.time[at] > 0.5 ? NaN : line.values[at];
}

// As many decimals as the range of a plot deserves: four digits of its largest value.
function decimalsOf(described) {
  let largest = 0;
  for (const line of described.lines) for (const value of line.values) if (Math.abs(value) > largest) largest = Math.abs(value);
  return largest > 0 ? Math.min(Math.max(3 - Math.floor(Math.log10(largest)), 0), 4) : 0;
}

function drawEvents(chart) {
  const { ctx, bbox } = chart;
  ctx.save();
  for (const event of run.events) {
    const at = chart.valToPos(event.time, 'x', true);
    if (at < bbox.left || at > bbox.left + bbox.width) continue;
    const height = event.bad ? bbox.height : 6 * devicePixelRatio;
    ctx.fillStyle = event.bad ? colourOf('bad') : `${colourOf('dim')}99`;
    ctx.fillRect(Math.round(at), bbox.top + bbox.height - height, Math.max(devicePixelRatio, 1), height);
  }
  ctx.restore();
}

function zoomTo(begin, end) {
  const whole = begin <= 0 && end >= run.duration;
  element('whole-run').disabled = whole;
  for (const plot of plots) plot.chart.setScale('x', { min: begin, max: end });
}

class Plot {
  constructor(described) {
    this.described = described;
    this.decimals = decimalsOf(described);
    this.box = document.createElement('figure');
    this.box.className = 'plot';
    this.box.id = `plot-${described.id}`;
    const caption = document.createElement('figcaption');
    const title = document.createElement('b');
    title.textContent = described.unit ? `${described.title} [${described.unit}]` : described.title;
    caption.append(title);
    this.values = described.lines.map((line) => {
      const key = document.createElement('span');
      key.className = `key ${line.colour} ${line.kind}`;
      const value = document.createElement('output');
      key.append(`${line.label} `, value);
      caption.append(key);
      return value;
    });
    this.line = document.createElement('div');
    this.line.className = 'time-line';
    this.box.append(caption);
    this.data = tableOf(described);
    this.draw();
  }

  draw() {
    const described = this.described;
    const low = described.lines.findIndex((line) => line.kind === 'low');
    const ink = colourOf('dim');
    const grid = { stroke: colourOf('line'), width: 1 };
    const axis = { stroke: ink, grid, ticks: grid, font: '12px system-ui, sans-serif' };
    if (this.chart !== undefined) this.chart.destroy();
    this.chart = new libraries.uPlot({
      width: Math.max(this.box.clientWidth, 200),
      height: PLOT_HEIGHT,
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false } },
      scales: { x: { time: false, min: 0, max: run.duration } },
      axes: [
        { ...axis, size: 30, values: (_, ticks) => ticks.map((tick) => `${+tick.toFixed(3)} s`) },
        { ...axis, size: 52 },
      ],
      series: [{}, ...described.lines.map(seriesOf)],
      bands: low < 0 ? [] : [{ series: [low + 2, low + 1], fill: `${colourOf('window')}30` }],
      hooks: {
        drawClear: [drawEvents],
        setSelect: [(chart) => {
          const { left, width } = chart.select;
          if (width > 8) zoomTo(chart.posToVal(left, 'x'), chart.posToVal(left + width, 'x'));
          chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
        ready: [(chart) => {
          chart.over.append(this.line);
          chart.over.addEventListener('click', (press) => {
            const time = chart.posToVal(press.clientX - chart.over.getBoundingClientRect().left, 'x');
            if (!this.dragged) player.go(time);
          });
          chart.over.addEventListener('mousedown', (press) => { this.downAt = press.clientX; });
          chart.over.addEventListener('mouseup', (press) => { this.dragged = Math.abs(press.clientX - this.downAt) > 8; });
          chart.over.addEventListener('dblclick', () => zoomTo(0, run.duration));
        }],
        setScale: [() => this.mark(player.time)],
      },
    }, this.data, this.box);
    this.mark(player.time);
  }

  mark(time) {
    if (this.chart === undefined) return;
    const at = this.chart.valToPos(time, 'x');
    this.line.hidden = !(at >= 0 && at <= this.chart.over.clientWidth);
    this.line.style.transform = `translateX(${at.toFixed(1)}px)`;
  }

  show(time) {
    this.mark(time);
    this.described.lines.forEach((line, i) => {
      const value = valueAt(line, time);
      this.values[i].textContent = Number.isFinite(value)
        ? (value.toFixed(this.decimals).replace(/^-(0(\.0+)?)$/, '$1')).replace('-', '\u2212') : '–';
    });
  }
}

function startPlots() {
  const box = element('plots');
  if (run.plots.length === 0) {
    box.textContent = 'There is nothing to plot in this record.';
    return;
  }
  for (const described of run.plots) {
    const figure = new Plot(described);
    box.append(figure.box);
    plots.push(figure);
  }
  const fit = () => {
    for (const plot of plots) {
      const width = plot.box.clientWidth;
      if (width > 0 && width !== plot.chart.width) plot.chart.setSize({ width, height: PLOT_HEIGHT });
      plot.mark(player.time);
    }
  };
  new ResizeObserver(fit).observe(box);
  fit();
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
    for (const plot of plots) plot.draw();
    fit();
  });
  element('whole-run').addEventListener('click', () => zoomTo(0, run.duration));
  player.listen((time) => plots.forEach((plot) => plot.show(time)));
}
