// What a chart says under the pointer: the values of every curve at one x, or the words of the nearest mark.
// Curves carry their numbers (data-x, data-y, data-label, data-kind), marks their words (data-tip).
// Without this script the page is whole, only silent; so it may fail as a whole, and never needs the network.
"use strict";
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const box = document.createElement("div");
  box.className = "tip";
  box.setAttribute("role", "status");
  document.body.append(box);

  const numbers = (text) => text.split(" ").map(Number);
  const points = (line) => line.getAttribute("points").trim().split(" ").map((pair) => pair.split(",").map(Number));
  const say = (value, kind) => kind === "share" ? (100 * value).toFixed(1) + " %" : String(+value.toPrecision(4));

  function nearest(values, wanted) {
    let best = 0;
    values.forEach((value, row) => { if (Math.abs(value - wanted) < Math.abs(values[best] - wanted)) best = row; });
    return best;
  }

  function row(colour, text) {
    const line = document.createElement("span");
    const swatch = document.createElement("i");
    swatch.style.background = colour;
    line.append(swatch, text);
    return line;
  }

  function show(rows, event) {
    box.replaceChildren(...rows);
    box.style.display = "block";
    const wide = document.documentElement.clientWidth;
    const left = event.clientX + 16 + box.offsetWidth > wide ? event.clientX - 16 - box.offsetWidth : event.clientX + 16;
    box.style.left = Math.max(4, left) + window.scrollX + "px";
    box.style.top = event.clientY + 14 + window.scrollY + "px";
  }

  function curves(chart) {
    const lines = [...chart.querySelectorAll("[data-y]")].map((line) => ({
      label: line.dataset.label, kind: line.dataset.kind, colour: getComputedStyle(line).getPropertyValue("--ink-of"),
      x: numbers(line.dataset.x), y: numbers(line.dataset.y), at: points(line),
    }));
    const overlay = document.createElementNS(SVG, "g");
    chart.append(overlay);
    const all = lines.flatMap((line) => line.x);
    return (where, event) => {
      const at = lines.flatMap((line) => line.at.slice(0, line.x.length).map((point) => point[0]));
      const x = all[nearest(at, where.x)];
      const told = [];
      overlay.replaceChildren();
      for (const line of lines) {
        if (x > Math.max(...line.x)) continue;
        const index = nearest(line.x, x);
        const [cx, cy] = line.at[index];
        if (overlay.childElementCount === 0) overlay.append(guide(chart, cx));
        const dot = document.createElementNS(SVG, "circle");
        dot.setAttribute("cx", cx); dot.setAttribute("cy", cy); dot.setAttribute("r", 4);
        dot.setAttribute("style", "fill:" + line.colour);
        overlay.append(dot);
        told.push([line.y[index], row(line.colour, line.label + " " + say(line.y[index], line.kind))]);
      }
      told.sort((one, other) => other[0] - one[0]);
      const head = row("transparent", (chart.dataset.x || "") + " " + x.toLocaleString("en"));
      show([head, ...told.map((pair) => pair[1])], event);
      return () => overlay.replaceChildren();
    };
  }

  function guide(chart, x) {
    const line = document.createElementNS(SVG, "line");
    const [top, bottom] = numbers(chart.dataset.inside);
    Object.entries({ x1: x, x2: x, y1: top, y2: bottom, class: "guide" }).forEach(([k, v]) => line.setAttribute(k, v));
    return line;
  }

  function marks(chart) {
    const found = [...chart.querySelectorAll("[data-tip]")].map((mark) => {
      const place = mark.getBBox();
      return { mark, x: place.x + place.width / 2, y: place.y + place.height / 2 };
    });
    return (where, event) => {
      const under = found.find((one) => one.mark === event.target);
      const apart = found.map((one) => Math.hypot(one.x - where.x, one.y - where.y));
      const best = nearest(apart, 0);
      if (!under && apart[best] > 24) { box.style.display = "none"; return () => {}; }
      const { mark } = under || found[best];
      mark.classList.add("here");
      show([row(getComputedStyle(mark).fill, mark.dataset.tip)], event);
      return () => mark.classList.remove("here");
    };
  }

  for (const chart of document.querySelectorAll("svg.chart")) {
    const kind = chart.querySelector("[data-y]") ? curves : chart.querySelector("[data-tip]") ? marks : null;
    if (!kind) continue;
    let look = null;
    let clear = () => {};
    const leave = () => { clear(); clear = () => {}; box.style.display = "none"; };
    const move = (event) => {
      look = look || kind(chart);
      clear();
      const where = new DOMPoint(event.clientX, event.clientY).matrixTransform(chart.getScreenCTM().inverse());
      clear = look(where, event);
    };
    chart.addEventListener("pointermove", move);
    chart.addEventListener("pointerdown", move);
    chart.addEventListener("pointerleave", leave);
  }
})();
