// Charts of recordings: zoom with the wheel or keys, pan by dragging, values at the cursor. The picture below is for print.
"use strict";
(() => {
  const charts = JSON.parse(document.getElementById("charts").textContent);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const floats = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const [LEFT, RIGHT, HIGH, LOW] = [64, 10, 118, 28];

  // about so many round numbers between two values
  function ticks(low, high, count) {
    const raw = (high - low) / count || 1;
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = power * ([1, 2, 5].find((own) => own * power >= raw) ?? 10);
    const found = [];
    for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) found.push(k * step);
    return found.map((value) => [value, String(Number(value.toPrecision(6)))]);
  }

  function show(figure) {
    const own = charts[figure.dataset.chart];
    if (!own) return;
    const time = floats(own.time);
    const panels = own.panels.map((panel) => ({ ...panel, lines: panel.lines.map((line) => ({ ...line, values: floats(line.values) })) }));
    const canvas = document.createElement("canvas");
    const said = document.createElement("p");
    const image = figure.querySelector("img");
    said.className = "readout";
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${image.alt}. Keys: arrows move the cursor, + and - zoom, 0 shows all.`);
    image.before(canvas, said);
    figure.classList.add("charted");
    const all = [time[0], time[time.length - 1]];
    let [from, until] = all;
    let cursor = null;
    let drag = null;

    const x = (t, wide) => LEFT + ((t - from) / (until - from)) * (wide - LEFT - RIGHT);
    const at = (place) => from + ((place - LEFT) / (canvas.clientWidth - LEFT - RIGHT)) * (until - from);
    const first = (t) => {
      let [low, high] = [0, time.length];
      while (low < high) {
        const middle = (low + high) >> 1;
        if (time[middle] < t) low = middle + 1;
        else high = middle;
      }
      return low;
    };

    function draw() {
      const [wide, tall, dots] = [canvas.clientWidth, HIGH * panels.length + LOW, devicePixelRatio || 1];
      canvas.style.height = `${tall}px`;
      canvas.width = wide * dots;
      canvas.height = tall * dots;
      const on = canvas.getContext("2d");
      on.scale(dots, dots);
      on.font = "12px system-ui, sans-serif";
      const colours = dark.matches ? ["#56B4E9", "#E69F00"] : ["#0072B2", "#D55E00"];
      const [begin, end] = [Math.max(first(from) - 2, 0), Math.min(first(until) + 2, time.length)];
      panels.forEach((panel, row) => {
        const [top, bottom] = [row * HIGH + 20, (row + 1) * HIGH - 6];
        let [low, high] = [Infinity, -Infinity];
        for (const { values } of panel.lines) {
          for (let k = begin; k < end; k++) {
            if (values[k] < low) low = values[k];
            if (values[k] > high) high = values[k];
          }
        }
        if (!(high > low)) [low, high] = [(Number.isFinite(low) ? low : 0) - 1, (Number.isFinite(low) ? low : 0) + 1];
        const margin = 0.06 * (high - low);
        [low, high] = [low - margin, high + margin];
        const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
        on.strokeStyle = css("--line");
        on.fillStyle = css("--soft");
        on.textAlign = "right";
        for (const [value, text] of ticks(low, high, 5)) {
          on.beginPath();
          on.moveTo(LEFT, y(value));
          on.lineTo(wide - RIGHT, y(value));
          on.stroke();
          on.fillText(text, LEFT - 6, y(value) + 4);
        }
        on.textAlign = "left";
        on.fillStyle = css("--ink");
        on.fillText(panel.title + (panel.lines.length ? "" : ": not measured"), LEFT, top - 6);
        let place = LEFT + on.measureText(panel.title).width + 24;
        on.save();
        on.beginPath();
        on.rect(LEFT, top, wide - LEFT - RIGHT, bottom - top);
        on.clip();
        panel.lines.forEach((line, k) => {
          on.strokeStyle = colours[k];
          on.beginPath();
          for (let n = begin; n < end; n++) on.lineTo(x(time[n], wide), y(line.values[n]));
          on.stroke();
        });
        on.restore();
        panel.lines.forEach((line, k) => {
          on.fillStyle = colours[k];
          on.fillText(line.label, place, top - 6);
          place += on.measureText(line.label).width + 16;
        });
      });
      on.fillStyle = css("--soft");
      on.textAlign = "center";
      for (const [value, text] of ticks(from, until, 8)) on.fillText(text, x(value, wide), tall - 14);
      on.fillText("time, s", (LEFT + wide - RIGHT) / 2, tall - 1);
      if (cursor !== null && cursor >= from && cursor <= until) {
        on.strokeStyle = css("--ink");
        on.setLineDash([3, 3]);
        on.beginPath();
        on.moveTo(x(cursor, wide), 0);
        on.lineTo(x(cursor, wide), tall - LOW);
        on.stroke();
      }
      say();
    }

    function say() {
      if (cursor === null) {
        said.textContent = "Point at the signals, or press an arrow key. Wheel or + and −: zoom. Drag: pan. 0: all.";
        return;
      }
      let k = Math.min(first(cursor), time.length - 1);
      if (k && cursor - time[k - 1] < time[k] - cursor) k -= 1;
      if (own.pairs) k -= k % 2;
      const texts = panels.filter((panel) => panel.lines.length).map((panel) => {
        const [title, unit] = panel.title.split(", ");
        const values = panel.lines.map(({ label, values }) => {
          const written = (value, digits) => (Number.isFinite(value) ? value.toPrecision(digits) : "none");
          const number = own.pairs ? `${written(values[k], 4)} … ${written(values[k + 1], 4)}` : written(values[k], 5);
          return label ? `${label} ${number}` : number;
        });
        return `${title} ${values.join(", ")} ${unit}`;
      });
      said.textContent = `${time[k].toFixed(3)} s: ${texts.join("; ")}`;
    }

    function zoom(factor, middle) {
      const length = Math.min(Math.max((until - from) * factor, 1e-3 * (all[1] - all[0])), all[1] - all[0]);
      const begin = middle - ((middle - from) / (until - from)) * length;
      move(begin, length);
    }
    function move(begin, length) {
      from = Math.min(Math.max(begin, all[0]), all[1] - length);
      until = from + length;
      draw();
    }

    canvas.addEventListener("wheel", (event) => {
      if (event.deltaY > 0 && until - from >= all[1] - all[0]) return; // all is shown: the page scrolls on
      event.preventDefault();
      zoom(event.deltaY > 0 ? 1.25 : 0.8, at(event.offsetX));
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      drag = [event.offsetX, from];
    });
    canvas.addEventListener("pointerup", () => (drag = null));
    canvas.addEventListener("pointermove", (event) => {
      if (drag) {
        const length = until - from;
        move(drag[1] - ((event.offsetX - drag[0]) / (canvas.clientWidth - LEFT - RIGHT)) * length, length);
        return;
      }
      cursor = Math.min(Math.max(at(event.offsetX), from), until);
      draw();
    });
    canvas.addEventListener("dblclick", () => move(all[0], all[1] - all[0]));
    canvas.addEventListener("keydown", (event) => {
      const middle = cursor ?? 0.5 * (from + until);
      const step = 0.01 * (until - from);
      if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
        cursor = Math.min(Math.max(middle + (event.key === "ArrowLeft" ? -step : step), all[0]), all[1]);
        if (cursor < from || cursor > until) move(cursor - 0.5 * (until - from), until - from);
        else draw();
      } else if (event.key === "+") zoom(0.5, middle);
      else if (event.key === "-") zoom(2, middle);
      else if (event.key === "0") move(all[0], all[1] - all[0]);
      else return;
      event.preventDefault();
    });
    dark.addEventListener("change", draw);
    new ResizeObserver(draw).observe(figure);
    draw();
  }

  document.querySelectorAll("[data-chart]").forEach(show);
})();
