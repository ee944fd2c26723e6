// Curves answer the mouse. Names and numbers from files become text only, never markup.
const MOST = 8; // values at once
const SVG = "http://www.w3.org/2000/svg";

for (const chart of document.querySelectorAll(".chart")) {
  for (const button of chart.querySelectorAll("button")) {
    button.addEventListener("click", () => {
      const shown = button.getAttribute("aria-pressed") === "false";
      button.setAttribute("aria-pressed", shown);
      for (const series of chart.querySelectorAll("[data-name]")) {
        if (series.dataset.name === button.dataset.name) series.classList.toggle("off", !shown);
      }
    });
  }
  chart.querySelectorAll(".panel").forEach(answerMouse);
}

function answerMouse(panel) {
  const svg = panel.querySelector("svg"), tip = panel.querySelector(".tip");
  const [left, top, right, bottom] = svg.dataset.frame.split(" ").map(Number);
  const [x0, x1, y0, y1] = svg.dataset.limits.split(" ").map(Number);
  const lines = [...svg.querySelectorAll(".line, .dashed, .marks")].map((path) => ({
    path, name: path.closest("[data-name]").dataset.name, points: pointsOf(path),
  }));
  const cursor = svg.appendChild(document.createElementNS(SVG, "g"));
  const number = (value, range) => {
    const digits = 3 - Math.floor(Math.log10(range)); // a thousandth of the axis or less
    return value.toLocaleString("en", { maximumFractionDigits: Math.max(0, Math.min(20, digits)) });
  };

  function show(event) {
    const box = svg.getBoundingClientRect(), scale = svg.viewBox.baseVal.width / box.width;
    const x = (event.clientX - box.left) * scale, y = (event.clientY - box.top) * scale;
    hide();
    if (x < left - 5 || x > right + 5) return;
    const found = lines
      .filter(({ path, points }) => points.length && !path.closest(".off"))
      .map(({ path, name, points }) => ({ path, name, at: nearest(points, x) }))
      .filter(({ path, at }) => !path.matches(".marks") || Math.abs(at[0] - x) < 6)
      .sort((a, b) => Math.abs(a.at[1] - y) - Math.abs(b.at[1] - y))
      .slice(0, MOST);
    if (!found.length) return;
    const value = x0 + ((found[0].at[0] - left) / (right - left)) * (x1 - x0);
    addRow(`${tip.dataset.x} ${number(value, x1 - x0)}`);
    for (const { path, name, at } of found.sort((a, b) => a.at[1] - b.at[1])) {
      const value = y0 + ((bottom - at[1]) / (bottom - top)) * (y1 - y0);
      const note = path.getAttribute("aria-label");
      addRow(`${name}${note ? `, ${note}` : ""}: ${number(value, y1 - y0)}`, path.closest("g").style.cssText);
      const dot = cursor.appendChild(document.createElementNS(SVG, "circle"));
      dot.style.cssText = path.closest("g").style.cssText;
      for (const [key, part] of [["cx", at[0]], ["cy", at[1]], ["r", 4]]) dot.setAttribute(key, part);
    }
    tip.hidden = false;
    tip.style.left = x > (left + right) / 2 ? "" : `${(x + 12) / scale}px`;
    tip.style.right = x > (left + right) / 2 ? `${box.width - (x - 12) / scale}px` : "";
  }

  function addRow(text, color = "") {
    const row = tip.appendChild(document.createElement("div"));
    row.textContent = text;
    row.style.cssText = color;
  }

  function hide() {
    tip.hidden = true;
    tip.replaceChildren();
    cursor.replaceChildren();
  }

  svg.addEventListener("pointermove", show);
  svg.addEventListener("pointerdown", show);
  svg.addEventListener("pointerleave", hide);
}

function pointsOf(path) {
  return [...path.getAttribute("d").matchAll(/(-?[\d.]+),(-?[\d.]+)/g)].map((m) => [+m[1], +m[2]]);
}

function nearest(points, x) {
  return points.reduce((a, b) => (Math.abs(b[0] - x) < Math.abs(a[0] - x) ? b : a));
}
