"use strict";
(() => {
  const page = JSON.parse(document.getElementById("page-data").textContent);
  const root = document.documentElement;
  const button = document.getElementById("theme");
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  const drawn = new Set();
  const setup = { displaylogo: false, responsive: true, modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"] };
  let chosen = null;

  const element = (number) => document.getElementById(`chart-${number}`);
  const theme = () => chosen || (system.matches ? "dark" : "light");

  function draw(number) {
    if (drawn.has(number)) return;
    drawn.add(number);
    const chart = page.charts[number];
    const node = element(number);
    Plotly.newPlot(node, chart.data, { ...chart.layout, template: page.themes[root.dataset.theme], autosize: true }, setup);
    if (chart.linked) linkScenes(node);
  }

  function linkScenes(node) {
    const scenes = Object.keys(node._fullLayout).filter((key) => /^scene\d*$/.test(key));
    node.on("plotly_relayout", (change) => {
      const moved = scenes.find((scene) => change[`${scene}.camera`]);
      if (!moved) return;
      const update = {};
      scenes.filter((scene) => scene !== moved && !change[`${scene}.camera`])
        .forEach((scene) => { update[`${scene}.camera`] = change[`${moved}.camera`]; });
      if (Object.keys(update).length) Plotly.relayout(node, update);
    });
  }

  function paint(name) {
    if (root.dataset.theme === name) return;
    root.dataset.theme = name;
    if (button) button.textContent = name === "dark" ? "Light" : "Dark";
    drawn.forEach((number) => Plotly.relayout(element(number), { template: page.themes[name] }));
  }

  function drawNext(number) {
    if (number >= page.charts.length) return;
    draw(number);
    window.setTimeout(() => drawNext(number + 1), 0);
  }

  paint(theme());
  button.hidden = false;
  button.addEventListener("click", () => {
    chosen = root.dataset.theme === "dark" ? "light" : "dark";
    paint(chosen);
  });
  system.addEventListener("change", () => paint(theme()));
  window.addEventListener("beforeprint", () => {
    paint("light");
    document.querySelectorAll("details").forEach((fold) => { fold.dataset.was = fold.open; fold.open = true; });
    page.charts.forEach((_, number) => {
      draw(number);
      const node = element(number);
      const share = node.parentElement.parentElement.closest(".columns") ? 0.5 : 1;
      Plotly.relayout(node, { width: 680 * share, autosize: false });
    });
  });
  window.addEventListener("afterprint", () => {
    paint(theme());
    document.querySelectorAll("details").forEach((fold) => { fold.open = fold.dataset.was === "true"; });
    page.charts.forEach((_, number) => Plotly.relayout(element(number), { width: null, autosize: true }));
  });
  drawNext(0);
})();
