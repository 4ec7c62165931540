// The comparison's curves: one pair of panels a channel, one time axis for all, drawn by uPlot.
// Only what the screen can show is fetched; closer looks fetch finer curves.

const HEIGHT = 150, ERROR_HEIGHT = 105;
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export class Plots {
  constructor(box, onRange) {
    this.box = box;
    this.onRange = onRange;
    this.panels = [];
    this.about = null;
    this.view = [0, 1];
    this.frame = 0;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#build());
    new ResizeObserver(() => this.#resize()).observe(box);
    box.addEventListener("keydown", (event) => this.#key(event));
  }

  // Show one of the records compared.
  async load(record) {
    const answer = await fetch(`/api/about?record=${record}`);
    if (!answer.ok) return;
    const before = this.about;
    this.record = record;
    this.about = await answer.json();
    const same = before && before.begin === this.about.begin && before.end === this.about.end;
    if (!same) this.view = [this.about.begin, this.about.end];
    await this.#fetch();
    this.#build();
  }

  // Show the times from begin to end.
  show(begin, end) {
    const { begin: first, end: last } = this.about;
    const width = Math.min(Math.max(end - begin, (last - first) * 1e-5), last - first);
    const left = Math.min(Math.max((begin + end - width) / 2, first), last - width);
    this.view = [left, left + width];
    if (!this.frame) this.frame = requestAnimationFrame(() => this.#draw());
  }

  zoom(factor, around) {
    const [begin, end] = this.view;
    const middle = around ?? (begin + end) / 2;
    this.show(middle - (middle - begin) * factor, middle + (end - middle) * factor);
  }

  pan(share) {
    const [begin, end] = this.view;
    this.show(begin + share * (end - begin), end + share * (end - begin));
  }

  whole() { this.show(this.about.begin, this.about.end); }

  #draw() {
    this.frame = 0;
    const [min, max] = this.view;
    for (const panel of this.panels) panel.setScale("x", { min, max });
    this.onRange(min, max);
    const { begin, end, thin } = this.loaded;
    const missing = min < begin - 1e-9 || max > end + 1e-9;
    if (missing || (thin && (max - min) * 5 < end - begin)) {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.#fetch().then(() => this.#fill()), 60);
    }
  }

  // Fetch what is shown and as much again on either side.
  async #fetch() {
    const [min, max] = this.view, width = max - min;
    const begin = Math.max(min - width, this.about.begin), end = Math.min(max + width, this.about.end);
    const points = Math.round(2 * Math.max(this.box.clientWidth, 600) * (end - begin) / width);
    this.abort?.abort();
    this.abort = new AbortController();
    try {
      const answer = await fetch(`/api/curves?record=${this.record}&begin=${begin}&end=${end}&points=${points}`,
        { signal: this.abort.signal });
      const bytes = await answer.arrayBuffer();
      const curves = this.about.curves.length, m = bytes.byteLength / (8 + 4 * curves);
      const time = new Float64Array(bytes, 0, m);
      this.data = [time];
      for (let k = 0; k < curves; k++) {
        this.data.push(gaps(new Float32Array(bytes, 8 * m + 4 * m * k, m)));
      }
      this.loaded = { begin, end, thin: m < this.about.n * (end - begin) / (this.about.end - this.about.begin) * 0.95 };
    } catch (error) {
      if (error.name !== "AbortError") throw error;
    }
  }

  #fill() {
    const [min, max] = this.view;
    this.panels.forEach((panel, k) => {
      panel.setData(this.#of(k), false);
      panel.setScale("x", { min, max });
    });
  }

  // Panel 2c has measured and simulated of channel c, panel 2c + 1 its error.
  #of(k) {
    const first = 1 + 3 * (k >> 1);
    return k % 2 ? [this.data[0], this.data[first + 2]]
      : [this.data[0], this.data[first], this.data[first + 1]];
  }

  #build() {
    if (!this.data) return;
    for (const panel of this.panels) panel.destroy();
    this.panels = this.about.channels.flatMap((channel, c) => [
      this.#panel(2 * c, channel, HEIGHT, `${channel.name} [${channel.unit || "1"}]`, [
        { label: "measured", stroke: css("--measured"), width: 3, alpha: 0.5, points: { show: false } },
        { label: "simulated", stroke: css("--last"), width: 1.5, points: { show: false } },
      ]),
      this.#panel(2 * c + 1, channel, ERROR_HEIGHT, `error [${channel.unit || "1"}]`, [
        { label: "error", stroke: css("--first"), width: 1, points: { show: false } },
      ], c === this.about.channels.length - 1),
    ]);
    this.#draw();
  }

  #panel(k, channel, height, label, series, last = false) {
    const grid = { stroke: css("--grid"), width: 1 }, ticks = { stroke: css("--line"), width: 1 };
    const font = "12px system-ui, sans-serif";
    const axis = { stroke: css("--ink"), grid, ticks, font, labelFont: font };
    const options = {
      width: this.box.clientWidth, height: height + (last ? 22 : 0),
      legend: { show: false },
      scales: { x: { time: false, auto: false } },
      axes: [{ ...axis, size: last ? 30 : 24, ...(last && { label: "time [s]", labelSize: 18 }) },
        { ...axis, label, size: 70, labelSize: 18, space: 28 }],
      series: [{ label: "time [s]" }, ...series],
      cursor: {
        sync: { key: "twinproof" }, points: { show: false },
        drag: { x: true, y: false, setScale: false },
        bind: { mousedown: (u, _, zoom) => (event) => this.#press(u, event, zoom) },
      },
      hooks: {
        drawClear: [(u) => this.#shade(u, channel)],
        setSelect: [(u) => this.#select(u)],
      },
    };
    const panel = new uPlot(options, this.#of(k), this.box);
    panel.over.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY > 0 ? 1.25 : 0.8, panel.posToVal(event.offsetX, "x"));
    }, { passive: false });
    panel.over.addEventListener("dblclick", () => this.whole());
    return panel;
  }

  #shade(u, channel) {
    u.ctx.save();
    u.ctx.fillStyle = css("--first");
    for (const span of this.about.spans) {
      u.ctx.globalAlpha = span.channel === channel.name ? 0.2 : 0.09;
      const left = Math.max(u.valToPos(span.begin, "x", true), u.bbox.left);
      const right = Math.min(u.valToPos(span.end, "x", true), u.bbox.left + u.bbox.width);
      if (right > left) u.ctx.fillRect(left, u.bbox.top, Math.max(right - left, 1), u.bbox.height);
    }
    u.ctx.restore();
  }

  #select(u) {
    const { left, width } = u.select;
    if (width < 4) return;
    const begin = u.posToVal(left, "x"), end = u.posToVal(left + width, "x");
    for (const panel of this.panels) panel.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.show(begin, end);
  }

  #press(u, event, zoom) {
    if (!event.shiftKey) return zoom(event);
    event.preventDefault();
    const [begin, end] = this.view, scale = (end - begin) / u.over.clientWidth, from = event.clientX;
    const move = (e) => this.show(begin - (e.clientX - from) * scale, end - (e.clientX - from) * scale);
    const up = () => {
      removeEventListener("mousemove", move);
      removeEventListener("mouseup", up);
    };
    addEventListener("mousemove", move);
    addEventListener("mouseup", up);
    return null;
  }

  #key(event) {
    const act = {
      ArrowLeft: () => this.pan(-0.1), ArrowRight: () => this.pan(0.1), "+": () => this.zoom(0.8),
      "-": () => this.zoom(1.25), Home: () => this.whole(), 0: () => this.whole(),
    }[event.key];
    if (act && this.about) {
      event.preventDefault();
      act();
    }
  }

  #resize() {
    const width = this.box.clientWidth;
    if (!width) return;
    this.panels.forEach((panel) => panel.width !== width && panel.setSize({ width, height: panel.height }));
  }
}

// uPlot knows gaps as null.
function gaps(values) {
  for (let k = 0; k < values.length; k++) {
    if (Number.isNaN(values[k])) return Array.from(values, (v) => (Number.isNaN(v) ? null : v));
  }
  return values;
}
