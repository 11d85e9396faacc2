"use strict";
// The one script of a report. No library, no eval, nothing from elsewhere; the page is readable without it.
(() => {
  // --- tables sorted by their heads ------------------------------------------------------------------------------
  const numeric = /^[−+-]?[\d.,]+(e[−+-]?\d+)?/i;

  const cellKey = (row, k) => {
    const cell = row.cells[k];
    if (!cell) return null;
    const text = (cell.dataset.v ?? cell.textContent).trim();
    if (text === "" || text === "–") return null;
    return numeric.test(text) ? parseFloat(text.replace(/−/g, "-").replace(/,/g, "")) : text.toLowerCase();
  };

  const before = (a, b) => {
    if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
    return typeof a === "number" ? -1 : 1;
  };

  const sortTable = (table, k, direction) => {
    const body = table.tBodies[0];
    const rows = [...body.rows].map((row, n) => ({ row, n: row.dataset.n ?? (row.dataset.n = n), key: cellKey(row, k) }));
    rows.sort((a, b) => {
      if (direction === 0) return a.n - b.n;
      if (a.key === null || b.key === null) return (a.key === null) - (b.key === null) || a.n - b.n;
      return direction * before(a.key, b.key) || a.n - b.n;
    });
    body.append(...rows.map((r) => r.row));
  };

  const makeSortable = (table) => {
    const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells];
    heads.forEach((head, k) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const now = head.getAttribute("aria-sort");
        const next = now === null ? "ascending" : now === "ascending" ? "descending" : null;
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        if (next) head.setAttribute("aria-sort", next);
        sortTable(table, k, next === "ascending" ? 1 : next === "descending" ? -1 : 0);
      });
    });
  };

  // --- small helps -------------------------------------------------------------------------------------------------
  // Words go into the page as text nodes only: ids of points may hold anything.
  const el = (tag, attributes = {}, ...children) => {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.append(...children);
    return made;
  };

  const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

  const roundDown = (value) => {
    const power = 10 ** Math.floor(Math.log10(value));
    return [5, 2, 1].find((step) => step * power <= value * (1 + 1e-12)) * power;
  };

  // What is rounded to zero has no sign.
  const plain = (value, digits) => {
    const text = Math.abs(value).toFixed(digits);
    return (value < 0 && Number(text) !== 0 ? "−" : "") + text;
  };

  const signed = (value, digits) => {
    const text = plain(value, digits);
    return (value > 0 && Number(text) !== 0 ? "+" : "") + text;
  };

  // A number of 16 bits: sign, exponent (5), fraction (10).
  const half = (bits) => {
    const sign = bits & 0x8000 ? -1 : 1;
    const exponent = (bits >> 10) & 31;
    const fraction = bits & 1023;
    if (exponent === 31) return fraction ? NaN : sign * Infinity;
    return sign * (exponent ? (1 + fraction / 1024) * 2 ** (exponent - 15) : fraction * 2 ** -24);
  };

  const typed = {
    f4: (bytes) => new Float32Array(bytes.buffer),
    f2: (bytes) => Float32Array.from(new Uint16Array(bytes.buffer), half),
    d: (bytes, { n }) => {
      let [at, value] = [0, 0];
      return Uint32Array.from({ length: n }, () => {
        let [change, weight, byte] = [0, 1, 128];
        for (; byte & 128; weight *= 128) {
          byte = bytes[at++];
          change += (byte & 127) * weight;
        }
        value += change % 2 ? -(change + 1) / 2 : change / 2;
        return value;
      });
    },
    u3: (bytes, { low, step, n }) =>
      Float64Array.from({ length: n }, (_, k) => low + step * (bytes[3 * k] | (bytes[3 * k + 1] << 8) | (bytes[3 * k + 2] << 16))),
  };

  const unpack = (column) => {
    if ("one" in column) return new Float32Array(column.n).fill(column.one);
    if ("counts" in column) return Uint16Array.from(column.counts.flatMap((n, k) => new Array(n).fill(k)));
    const text = atob(column.base64);
    const bytes = new Uint8Array(text.length);
    for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
    return typed[column.kind](bytes, column);
  };

  // --- which point lies near a place -------------------------------------------------------------------------------
  class Grid {
    constructor(x, y) {
      this.x = x;
      this.y = y;
      const n = x.length;
      let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
      for (let k = 0; k < n; k++) {
        if (x[k] < x0) x0 = x[k];
        if (x[k] > x1) x1 = x[k];
        if (y[k] < y0) y0 = y[k];
        if (y[k] > y1) y1 = y[k];
      }
      this.side = clamp(Math.ceil(Math.sqrt(n / 2)), 1, 512);
      this.x0 = x0;
      this.y0 = y0;
      this.dx = (x1 - x0) / this.side || 1;
      this.dy = (y1 - y0) / this.side || 1;
      const cells = new Uint32Array(n);
      this.first = new Uint32Array(this.side * this.side + 1);
      for (let k = 0; k < n; k++) {
        cells[k] = this.row(y[k]) * this.side + this.column(x[k]);
        this.first[cells[k] + 1]++;
      }
      for (let c = 0; c < this.side * this.side; c++) this.first[c + 1] += this.first[c];
      const at = this.first.slice();
      this.members = new Uint32Array(n);
      for (let k = 0; k < n; k++) this.members[at[cells[k]]++] = k;
    }

    column(x) {
      return clamp(Math.floor((x - this.x0) / this.dx), 0, this.side - 1);
    }

    row(y) {
      return clamp(Math.floor((y - this.y0) / this.dy), 0, this.side - 1);
    }

    nearest(x, y, radius, allowed) {
      let best = -1;
      let least = radius * radius;
      const [c0, c1] = [this.column(x - radius), this.column(x + radius)];
      for (let r = this.row(y - radius); r <= this.row(y + radius); r++) {
        const end = this.first[r * this.side + c1 + 1];
        for (let m = this.first[r * this.side + c0]; m < end; m++) {
          const k = this.members[m];
          const square = (this.x[k] - x) ** 2 + (this.y[k] - y) ** 2;
          if (square <= least && allowed(k)) [best, least] = [k, square];
        }
      }
      return best;
    }
  }

  // --- a drawing with points and vectors ---------------------------------------------------------------------------
  const MARGIN = 16;
  const LONG = 0.07; // a long vector (90 % quantile) as a share of the width; of many vectors less, that they do not cover each other
  const FEW = 300;
  const MANY = 1500; // from so many points of a kind in view their signs are dots

  class Plot {
    // words: label, unit of vectors, unit of the ground and how it is written; down: y grows downwards.
    constructor(host, words, kinds) {
      this.words = words;
      this.kinds = kinds;
      this.shown = kinds.map(() => true);
      this.stretch = 1;
      this.chosen = -1;
      this.frames = 0;
      this.build(host);
      this.listen();
    }

    build(host) {
      this.canvas = el("canvas", { tabindex: "0", role: "img", "aria-label": this.words.label });
      this.tip = el("div", { class: "tip", role: "status", "aria-live": "polite" });
      this.hint = el("p", { class: "soft" },
        "Drag to move. Zoom with the buttons, with + and −, or with the wheel after a click. Keys: arrows move, 0 shows all, n and p go from point to point, Esc lets go.");
      this.tools = el("div", { class: "tools" });
      for (const [sign, name, act] of [["+", "zoom in", () => this.zoom(1.5)], ["−", "zoom out", () => this.zoom(1 / 1.5)],
        ["⤢", "show all", () => this.fit(true)], ["points", "show the points", () => this.fit()]]) {
        const button = el("button", { type: "button", "aria-label": name, title: name }, sign);
        button.addEventListener("click", act);
        this.tools.append(button);
      }
      [this.toAll, this.toPoints] = [...this.tools.children].slice(-2);
      const slider = el("input", { type: "range", min: "-1.5", max: "1.5", step: "0.05", value: "0" });
      slider.addEventListener("input", () => {
        this.stretch = 10 ** Number(slider.value);
        this.ask();
      });
      this.tools.append(el("label", {}, "vectors ", slider));
      this.search = el("input", { type: "search", placeholder: "id", size: "8", spellcheck: "false" });
      this.search.addEventListener("keydown", (event) => {
        if (event.key === "Enter") this.words.find(this.search.value.trim());
      });
      this.tools.append(el("label", {}, "find ", this.search));
      this.choices = el("div", { class: "tools" });
      this.kinds.forEach((kind, k) => {
        const box = el("input", { type: "checkbox", checked: "" });
        box.addEventListener("change", () => {
          this.shown[k] = box.checked;
          this.ask();
        });
        this.choices.append(el("label", {}, box, el("span", { class: `key ${kind.key}`, "aria-hidden": "true" }, kind.sign), kind.name));
      });
      const frame = el("div", { class: "frame-of-canvas" }, this.canvas, this.tip);
      host.append(this.tools, this.choices, frame, this.hint);
    }

    // view: corners of the first view, or null; everything: name of the whole; x, y, kind of n points; vx, vy (nan: none); areas: [name, [[x, y] ...]]; tell(k): words on a point.
    show(data) {
      this.view = null;
      Object.assign(this, data);
      this.toPoints.hidden = !this.view;
      this.toAll.textContent = this.view ? `⤢ ${this.everything}` : "⤢";
      this.grid = new Grid(this.x, this.y);
      this.chosen = -1;
      this.say("");
      this.unitLength();
      this.fit();
    }

    // Vectors are long enough to see: drawing units per unit of the vector, before the slider.
    unitLength() {
      const lengths = [];
      for (let k = 0; k < this.vx.length; k++) {
        const length = Math.hypot(this.vx[k], this.vy[k]);
        if (length > 0) lengths.push(length);
      }
      const sorted = Float32Array.from(lengths).sort();
      this.long = sorted.length ? sorted[Math.floor(0.9 * (sorted.length - 1))] : 0;
      this.share = LONG * clamp(Math.sqrt(FEW / (sorted.length || 1)), 0.2, 1);
    }

    // The first view: all, or what the page names where areas are so large that the points would be a dot.
    fit(all = false) {
      const places = this.areas.flatMap((area) => area[1]);
      const g = this.grid;
      if (this.x.length) places.push([g.x0, g.y0], [g.x0 + g.dx * g.side, g.y0 + g.dy * g.side]);
      const [xs, ys] = [places.map((p) => p[0]), places.map((p) => p[1])];
      const whole = [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
      const [x0, y0, x1, y1] = this.view && !all ? this.view.flat() : whole;
      const within = (width, height) => Math.min((this.width - 2 * MARGIN) / width, (this.height - 2 * MARGIN) / height);
      this.middle = [(x0 + x1) / 2, (y0 + y1) / 2];
      this.size = [Math.max(x1 - x0, 1e-6), Math.max(y1 - y0, 1e-6)];
      this.measure();
      this.scale = within(...this.size);
      this.least = within(Math.max(whole[2] - whole[0], 1e-6), Math.max(whole[3] - whole[1], 1e-6)) / 4;
      this.near = 8 * (this.view && all ? within(this.view[1][0] - this.view[0][0], this.view[1][1] - this.view[0][1]) : this.scale);
      this.ask();
    }

    measure() {
      const ratio = window.devicePixelRatio || 1;
      this.width = this.canvas.parentElement.clientWidth || 300;
      this.height = clamp((this.width * this.size[1]) / this.size[0], 260, Math.max(300, Math.min(620, 0.8 * window.innerHeight)));
      this.canvas.width = Math.round(this.width * ratio);
      this.canvas.height = Math.round(this.height * ratio);
      this.canvas.style.height = `${this.height}px`;
      this.ratio = ratio;
    }

    toScreen(x, y) {
      const up = this.words.down ? 1 : -1;
      return [this.width / 2 + (x - this.middle[0]) * this.scale, this.height / 2 + up * (y - this.middle[1]) * this.scale];
    }

    toWorld(sx, sy) {
      const up = this.words.down ? 1 : -1;
      return [this.middle[0] + (sx - this.width / 2) / this.scale, this.middle[1] + (up * (sy - this.height / 2)) / this.scale];
    }

    zoom(factor, sx = this.width / 2, sy = this.height / 2) {
      const [x, y] = this.toWorld(sx, sy);
      this.scale = clamp(this.scale * factor, this.least, this.least * 4e6);
      const [nx, ny] = this.toWorld(sx, sy);
      this.middle = [this.middle[0] + x - nx, this.middle[1] + y - ny];
      this.ask();
    }

    pan(dx, dy) {
      this.middle = [this.middle[0] - dx / this.scale, this.middle[1] - ((this.words.down ? 1 : -1) * dy) / this.scale];
      this.ask();
    }

    // --- asking for a frame, drawing it
    ask() {
      if (this.asked) return;
      this.asked = true;
      requestAnimationFrame(() => {
        this.asked = false;
        this.draw();
      });
    }

    draw() {
      const began = performance.now();
      const paint = this.canvas.getContext("2d");
      const style = getComputedStyle(document.documentElement);
      this.colour = (name) => style.getPropertyValue(`--${name}`).trim();
      paint.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
      paint.clearRect(0, 0, this.width, this.height);
      this.drawAreas(paint);
      const order = this.kinds.map((_, k) => k).filter((k) => this.shown[k]).reverse(); // the rarer the higher
      const seen = order.map((k) => this.seen(k));
      const few = this.x.length <= MANY; // names may not hide one of a few points, nor many points the names
      if (few) this.drawNames(paint);
      for (const act of ["drawVectors", "drawPoints"]) order.forEach((k, m) => this[act](paint, this.kinds[k], seen[m]));
      if (!few) this.drawNames(paint);
      this.drawChosen(paint);
      this.drawBars(paint);
      this.canvas.dataset.frames = ++this.frames;
      this.canvas.dataset.ms = (performance.now() - began).toFixed(2);
    }

    drawAreas(paint) {
      for (const [, corners] of this.areas) {
        paint.beginPath();
        corners.forEach((p) => paint.lineTo(...this.toScreen(...p)));
        paint.closePath();
        paint.fillStyle = this.colour("foot");
        paint.fill();
        paint.setLineDash([5, 4]);
        paint.strokeStyle = this.colour("soft");
        paint.lineWidth = 1;
        paint.stroke();
        paint.setLineDash([]);
      }
    }

    drawNames(paint) {
      paint.font = "600 13px system-ui, sans-serif";
      paint.fillStyle = this.colour("soft");
      paint.strokeStyle = this.colour("page");
      paint.lineWidth = 3;
      const taken = [];
      for (const [name, corners] of this.areas) {
        if (!name) continue;
        const on = corners.map((p) => this.toScreen(...p));
        const top = on.reduce((a, b) => (b[1] < a[1] ? b : a));
        const [left, right] = [Math.min, Math.max].map((of) => of(...on.map((p) => p[0])));
        const bottom = Math.max(...on.map((p) => p[1]));
        if (right < 0 || left > this.width || bottom < 0 || top[1] > this.height) continue; // else they pile up at the border
        const wide = paint.measureText(name).width;
        const x = clamp(top[0] - wide / 2, 4, this.width - wide - 4);
        let y = Math.max(top[1] + 16, 14);
        while (taken.some((t) => Math.abs(t[1] - y) < 15 && x < t[0] + t[2] + 4 && t[0] < x + wide + 4)) y += 15;
        taken.push([x, y, wide]);
        paint.strokeText(name, x, y);
        paint.fillText(name, x, y);
      }
    }

    inside(sx, sy) {
      return sx > -9 && sy > -9 && sx < this.width + 9 && sy < this.height + 9;
    }

    get pixels() {
      return this.long ? ((this.share * this.width) / this.long) * this.stretch : 0;
    }

    // Numbers of the points of a kind that are seen, and where: written out, for it is asked in every frame.
    seen(number) {
      const rows = [];
      const [xs, ys] = [[], []];
      const up = this.words.down ? 1 : -1;
      const [x0, y0] = [this.width / 2 - this.middle[0] * this.scale, this.height / 2 - up * this.middle[1] * this.scale];
      for (let k = 0; k < this.x.length; k++) {
        if (this.kind[k] !== number) continue;
        const sx = x0 + this.x[k] * this.scale;
        const sy = y0 + up * this.y[k] * this.scale;
        if (!this.inside(sx, sy)) continue;
        rows.push(k);
        xs.push(sx);
        ys.push(sy);
      }
      return { rows, xs, ys };
    }

    drawVectors(paint, kind, { rows, xs, ys }) {
      const unit = this.pixels;
      if (!unit) return;
      const up = this.words.down ? unit : -unit;
      paint.beginPath();
      rows.forEach((k, m) => {
        const [dx, dy] = [unit * this.vx[k], up * this.vy[k]];
        if (!(dx * dx + dy * dy > 0.25)) return; // none, or too short to be seen
        paint.moveTo(xs[m], ys[m]);
        paint.lineTo(xs[m] + dx, ys[m] + dy);
      });
      paint.strokeStyle = this.colour(kind.colour);
      paint.lineWidth = rows.length > MANY ? 1 : 1.6;
      paint.stroke();
    }

    drawPoints(paint, kind, { rows, xs, ys }) {
      const many = rows.length > MANY;
      paint.fillStyle = paint.strokeStyle = this.colour(kind.colour);
      if (many) return this.drawCloud(paint, xs, ys, kind.shape === "dot" ? 150 : 255);
      if (kind.shape === "dot") return rows.forEach((_, m) => paint.fillRect(xs[m] - 1.75, ys[m] - 1.75, 3.5, 3.5));
      paint.beginPath();
      const r = kind.shape === "ring" ? (rows.length > 200 ? 3 : 4) : rows.length > 200 ? 4 : 6;
      rows.forEach((_, m) => {
        const [sx, sy] = [xs[m], ys[m]];
        if (kind.shape === "triangle") {
          paint.moveTo(sx, sy - r);
          paint.lineTo(sx + 0.87 * r, sy + r / 2);
          paint.lineTo(sx - 0.87 * r, sy + r / 2);
          paint.closePath();
        } else {
          paint.moveTo(sx + r, sy);
          paint.arc(sx, sy, r, 0, 2 * Math.PI);
        }
      });
      if (kind.shape === "triangle") paint.fill();
      else {
        paint.lineWidth = rows.length > 200 ? 1.4 : 2;
        paint.stroke();
      }
    }

    // Very many points: squares of two pixels written into a picture, ten times as quick as so many shapes.
    drawCloud(paint, xs, ys, opacity) {
      const { width, height } = this.canvas;
      if (this.cloud?.width !== width || this.cloud.height !== height) {
        this.cloud = Object.assign(document.createElement("canvas"), { width, height });
        this.image = new ImageData(width, height);
        this.words32 = new Uint32Array(this.image.data.buffer);
      }
      const [r, g, b] = [1, 3, 5].map((k) => parseInt(paint.fillStyle.slice(k, k + 2), 16)); // #rrggbb, as the canvas says it
      const word = ((opacity << 24) | (b << 16) | (g << 8) | r) >>> 0;
      this.words32.fill(0);
      const side = Math.max(2, Math.round(1.6 * this.ratio));
      for (let m = 0; m < xs.length; m++) {
        const x0 = Math.round(xs[m] * this.ratio - side / 2);
        const y0 = Math.round(ys[m] * this.ratio - side / 2);
        if (x0 < 0 || y0 < 0 || x0 + side > width || y0 + side > height) continue;
        for (let y = y0; y < y0 + side; y++) for (let x = x0; x < x0 + side; x++) this.words32[y * width + x] = word;
      }
      this.cloud.getContext("2d").putImageData(this.image, 0, 0);
      paint.drawImage(this.cloud, 0, 0, this.width, this.height);
    }

    drawChosen(paint) {
      if (this.chosen < 0) return;
      const [sx, sy] = this.toScreen(this.x[this.chosen], this.y[this.chosen]);
      paint.beginPath();
      paint.arc(sx, sy, 9, 0, 2 * Math.PI);
      paint.lineWidth = 2.5;
      paint.strokeStyle = this.colour("mark");
      paint.stroke();
    }

    drawBars(paint) {
      const ground = roundDown((0.2 * this.width) / this.scale);
      const rows = [[ground * this.scale, this.words.ground(ground)]];
      if (this.pixels) {
        const size = roundDown((0.2 * this.width) / this.pixels);
        rows.push([size * this.pixels, this.words.vector(Number(size.toPrecision(3)), this.pixels / this.scale)]);
      }
      paint.font = "13px system-ui, sans-serif";
      rows.forEach(([length, words], k) => {
        const y = this.height - 12 - 20 * (rows.length - 1 - k);
        const wide = paint.measureText(words).width;
        paint.fillStyle = this.colour("page");
        paint.globalAlpha = 0.8;
        paint.fillRect(6, y - 13, length + wide + 20, 19);
        paint.globalAlpha = 1;
        paint.strokeStyle = this.colour("ink");
        paint.lineWidth = 1.5;
        paint.beginPath();
        paint.moveTo(10, y - 7);
        paint.lineTo(10, y - 2);
        paint.lineTo(10 + length, y - 2);
        paint.lineTo(10 + length, y - 7);
        paint.stroke();
        paint.fillStyle = this.colour("ink");
        paint.fillText(words, 18 + length, y);
      });
    }

    // --- pointer and keys
    listen() {
      const pointers = new Map();
      const at = (event) => {
        const box = this.canvas.getBoundingClientRect();
        return [event.clientX - box.left, event.clientY - box.top];
      };
      this.canvas.addEventListener("pointerdown", (event) => {
        pointers.set(event.pointerId, at(event));
        this.moved = false;
        this.canvas.setPointerCapture(event.pointerId);
      });
      this.canvas.addEventListener("pointermove", (event) => {
        const before = pointers.get(event.pointerId);
        const now = at(event);
        if (!before) return this.hover(...now);
        const [other] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, p]) => p);
        pointers.set(event.pointerId, now);
        this.moved ||= Math.hypot(now[0] - before[0], now[1] - before[1]) > 0;
        if (!other) return this.pan(now[0] - before[0], now[1] - before[1]);
        const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
        this.zoom(apart(now) / apart(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
      });
      for (const name of ["pointerup", "pointercancel"]) {
        this.canvas.addEventListener(name, (event) => {
          if (pointers.delete(event.pointerId) && !this.moved && name === "pointerup") this.hover(...at(event));
        });
      }
      this.canvas.addEventListener("wheel", (event) => {
        if (document.activeElement !== this.canvas && !event.ctrlKey) return;
        event.preventDefault();
        this.zoom(Math.exp(-0.002 * clamp(event.deltaY, -200, 200)), ...at(event));
      }, { passive: false });
      this.canvas.addEventListener("keydown", (event) => this.key(event));
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.ask());
      new ResizeObserver(() => {
        if (!this.x || !this.canvas.parentElement.clientWidth || this.canvas.parentElement.clientWidth === this.width) return;
        this.fit();
      }).observe(this.canvas.parentElement);
    }

    key(event) {
      const moves = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (moves[event.key]) this.pan(...moves[event.key]);
      else if (event.key === "+" || event.key === "=") this.zoom(1.5);
      else if (event.key === "-" || event.key === "−") this.zoom(1 / 1.5);
      else if (event.key === "0") this.fit(true);
      else if (event.key === "n" || event.key === "p") this.next(event.key === "n" ? 1 : -1);
      else if (event.key === "Escape") this.choose(-1);
      else return;
      event.preventDefault();
    }

    next(step) {
      const n = this.x.length;
      let k = this.chosen;
      for (let tried = 0; tried < n; tried++) {
        k = k < 0 ? (step > 0 ? 0 : n - 1) : (k + step + n) % n;
        if (this.shown[this.kind[k]] && this.inside(...this.toScreen(this.x[k], this.y[k]))) return this.choose(k);
      }
    }

    hover(sx, sy) {
      const k = this.grid.nearest(...this.toWorld(sx, sy), 12 / this.scale, (m) => this.shown[this.kind[m]]);
      if (k >= 0 && k !== this.chosen) this.choose(k);
    }

    choose(k) {
      this.chosen = k;
      this.say(k < 0 ? "" : this.tell(k));
      this.ask();
    }

    // Show one point in the middle, with the points around it.
    goTo(k) {
      if (!this.shown[this.kind[k]]) {
        this.shown[this.kind[k]] = true;
        this.choices.querySelectorAll("input")[this.kind[k]].checked = true;
      }
      this.scale = Math.max(this.scale, this.near);
      this.middle = [this.x[k], this.y[k]];
      this.choose(k);
    }

    say(words) {
      this.tip.textContent = words;
      if (!words) return;
      const [sx, sy] = this.toScreen(this.x[this.chosen], this.y[this.chosen]);
      this.tip.style.left = `${clamp(sx + 14, 4, Math.max(4, this.width - this.tip.offsetWidth - 4))}px`;
      const above = sy - this.tip.offsetHeight - 12;
      this.tip.style.top = `${above > 2 ? above : Math.min(sy + 14, Math.max(2, this.height - this.tip.offsetHeight - 2))}px`;
    }
  }

  // --- the two drawings of an adjustment -----------------------------------------------------------------------------
  const reader = (data) => {
    const points = {};
    for (const [name, column] of Object.entries(data.points)) points[name] = name === "id" ? column : unpack(column);
    const rays = {};
    for (const [name, column] of Object.entries(data.rays)) rays[name] = name === "tested" ? column : unpack(column);
    const n = points.id.length;
    const first = new Uint32Array(n + 1);
    rays.point.forEach((p) => first[p + 1]++);
    for (let k = 0; k < n; k++) first[k + 1] += first[k];
    const at = first.slice();
    const of = new Uint32Array(rays.point.length);
    rays.point.forEach((p, k) => (of[at[p]++] = k));
    return { ...data, points, rays, raysOf: (k) => of.subarray(first[k], first[k + 1]) };
  };

  const rayWords = (block, r) => {
    const { vl, vs, wl, ws, tested } = block.rays;
    const own = Number.isNaN(wl[r]) || Number.isNaN(ws[r]) ? "" : `; ${tested ? "over own σ" : "v/σ"} ${signed(wl[r], 1)}, ${signed(ws[r], 1)}`;
    return `line ${signed(vl[r], 3)} px, sample ${signed(vs[r], 3)} px${own}`;
  };

  const pointWords = (block, k) => {
    const p = block.points;
    const axes = [["East", "east"], ["North", "north"], ["Up", "up"]];
    const out = [`${block.roles[p.role[k]]} ${p.id[k]}`];
    const errors = axes.filter(([, axis]) => k < p[axis].length && !Number.isNaN(p[axis][k])).map(([name, axis]) => `${name} ${signed(p[axis][k], 3)} m`);
    const sigmas = axes.filter(([, axis]) => !Number.isNaN(p[`sigma_${axis}`][k])).map(([name, axis]) => `${name} ${p[`sigma_${axis}`][k].toFixed(3)} m`);
    if (errors.length) out.push(`adjusted − measured: ${errors.join(", ")}`);
    if (sigmas.length) out.push(`σ: ${sigmas.join(", ")}`);
    const seen = [...block.raysOf(k)];
    seen.slice(0, 6).forEach((r) => out.push(`${block.images[block.rays.image[r]].id}: ${rayWords(block, r)}`));
    if (seen.length > 6) out.push(`${seen.length - 6} more images`);
    return out.join("\n");
  };

  const mapKinds = [
    { name: "control", sign: "▲", key: "of-control", colour: "control", shape: "triangle" },
    { name: "check", sign: "○", key: "of-check", colour: "check", shape: "ring" },
    { name: "tie", sign: "▪", key: "of-tie", colour: "tie", shape: "dot" },
  ];
  const rayKinds = [
    { name: "up to 3 σ", sign: "▪", key: "of-control", colour: "control", shape: "dot" },
    { name: "beyond 3 σ", sign: "○", key: "of-check", colour: "check", shape: "ring" },
  ];

  const metres = (km) => (km >= 1 ? `${km.toPrecision(3) / 1} km on the ground` : `${(1000 * km).toPrecision(3) / 1} m on the ground`);
  const times = (value) => `enlarged ${Number(value.toPrecision(2)).toLocaleString("en")} times`;

  const makeMap = (block, host, find) => {
    const p = block.points;
    const n = p.id.length;
    let up = false;
    const plot = new Plot(host, {
      label: "Map of points and errors", find, ground: metres,
      vector: (size, ratio) => `${size} m ${up ? "height" : "horizontal"} error, ${times(1000 * ratio)}`,
    }, mapKinds);
    const padded = (column) => {
      const out = new Float32Array(n).fill(NaN);
      out.set(column);
      return out;
    };
    const none = new Float32Array(n);
    const fill = () => {
      const [vx, vy] = up ? [none, padded(p.up)] : [padded(p.east), padded(p.north)];
      plot.show({ view: block.view, everything: "whole footprints", x: p.x, y: p.y, kind: p.role, vx, vy, areas: block.images.map((i) => [i.id, i.foot]), tell: (k) => pointWords(block, k) });
    };
    const which = el("select", {}, el("option", {}, "horizontal"), el("option", {}, "height"));
    which.addEventListener("change", () => {
      up = which.selectedIndex === 1;
      fill();
    });
    plot.tools.append(el("label", {}, "errors ", which));
    fill();
    return plot;
  };

  const makeResiduals = (block, host, find) => {
    const { image, line, sample, vl, vs, wl, ws, point } = block.rays;
    const plot = new Plot(host, {
      label: "Residuals in an image", find, down: true,
      ground: (px) => `${px.toPrecision(3) / 1} px in the image`, vector: (size, ratio) => `${size} px residual, ${times(ratio)}`,
    }, rayKinds);
    const which = el("select", {}, ...block.images.map((i) => el("option", {}, i.id)));
    const ends = new Uint32Array(block.images.length + 1); // image points of an image stand together
    image.forEach((i) => ends[i + 1]++);
    block.images.forEach((_, k) => (ends[k + 1] += ends[k]));
    const fill = () => {
      const number = which.selectedIndex;
      const rows = Uint32Array.from({ length: ends[number + 1] - ends[number] }, (_, k) => ends[number] + k);
      const pick = (column) => Float32Array.from(rows, (r) => column[r]);
      const kind = Uint8Array.from(rows, (r) => (Math.abs(wl[r]) > 3 || Math.abs(ws[r]) > 3 ? 1 : 0));
      const { lines, samples, view } = block.images[number];
      plot.rows = rows;
      plot.show({
        view, everything: "whole image", x: pick(sample), y: pick(line), vx: pick(vs), vy: pick(vl), kind, areas: [["", [[0, 0], [samples, 0], [samples, lines], [0, lines]]]],
        tell: (k) => `${block.points.id[point[rows[k]]]} at line ${plain(line[rows[k]], 1)}, sample ${plain(sample[rows[k]], 1)}\n${rayWords(block, rows[k])}`,
      });
    };
    which.addEventListener("change", fill);
    plot.tools.prepend(el("label", {}, "image ", which));
    fill();
    plot.goToPoint = (k) => {
      const seen = [...block.raysOf(k)];
      if (!seen.length) return;
      if (!seen.some((r) => image[r] === which.selectedIndex)) {
        which.selectedIndex = image[seen[0]];
        fill();
      }
      plot.goTo(plot.rows.findIndex((r) => point[r] === k));
    };
    return plot;
  };

  const start = () => {
    const source = document.getElementById("report-data");
    if (!source) return;
    const block = reader(JSON.parse(source.textContent));
    const plots = {};
    let last = -1;
    const find = (words) => {
      if (!words) return;
      const ids = block.points.id;
      let k = ids.indexOf(words);
      for (let m = 1; k < 0 && m <= ids.length; m++) {
        const next = (last + m + ids.length) % ids.length;
        if (ids[next].toLowerCase().includes(words.toLowerCase())) k = next;
      }
      if (k < 0) return Object.values(plots).forEach((plot) => (plot.tip.textContent = `no point with ${words} in its id`));
      last = k;
      plots.map?.goTo(k);
      plots.residuals?.goToPoint(k);
    };
    const put = (name, make) => {
      const host = document.getElementById(`live-${name}`);
      if (!host) return;
      host.parentElement.classList.add("alive");
      plots[name] = make(block, host, find);
    };
    put("map", makeMap);
    // the second drawing waits for the first to be seen
    requestAnimationFrame(() => requestAnimationFrame(() => {
      performance.mark("map");
      put("residuals", makeResiduals);
      requestAnimationFrame(() => requestAnimationFrame(() => performance.mark("drawn")));
    }));
  };

  // --- start ---------------------------------------------------------------------------------------------------------
  document.querySelectorAll("table.sortable").forEach(makeSortable);
  start();
  // what is folded away on the screen is printed
  addEventListener("beforeprint", () => document.querySelectorAll("details:not([open])").forEach((d) => {
    d.dataset.folded = "";
    d.open = true;
  }));
  addEventListener("afterprint", () => document.querySelectorAll("details[data-folded]").forEach((d) => {
    delete d.dataset.folded;
    d.open = false;
  }));
})();
