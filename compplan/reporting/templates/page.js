"use strict";
(async () => {
  const page = JSON.parse(await unpack("page-data"));
  const root = document.documentElement;
  const button = document.getElementById("theme");
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  const drawn = new Set();
  // No button sends a chart to a server: pages stay on this machine.
  const setup = {
    displaylogo: false, responsive: true, showSendToCloud: false, modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"],
  };
  // Between the margins of A4, in CSS pixels.
  const PAPER_WIDTH = 680;
  const PAPER_HEIGHT = 900;
  // Share of its size that a scene has on a phone.
  const NARROW_SCENE = 0.7;
  let chosen = null;

  const element = (number) => document.getElementById(`chart-${number}`);
  const theme = () => chosen || (system.matches ? "dark" : "light");
  const narrow = () => window.innerWidth < 620;
  const touched = () => window.matchMedia("(pointer: coarse)").matches;

  // Charts and their library lie in the page, compressed.
  async function unpack(name) {
    const text = document.getElementById(name).textContent;
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  }

  async function unpackLibrary() {
    const script = document.createElement("script");
    script.textContent = await unpack("plotly-library");
    document.head.append(script);
  }

  function draw(number) {
    if (drawn.has(number)) return;
    drawn.add(number);
    const chart = page.charts[number];
    const node = element(number);
    const layout = { ...chart.layout, template: page.themes[root.dataset.theme], autosize: true };
    if (narrow()) {
      layout.margin = { ...layout.margin, l: Math.min((layout.margin || {}).l ?? 48, 48), r: 8 };
      if (sideBySide(chart.layout)) node.style.minWidth = `${PAPER_WIDTH}px`;
      else shrinkScenes(layout);
    }
    if (touched()) holdStill(layout);
    Plotly.newPlot(node, chart.data, layout, { ...setup, displayModeBar: narrow() ? false : "hover" });
    if (touched()) offerTurning(node);
    if (chart.linked) linkScenes(node);
    if (chart.along) linkWaypoints(number, node);
  }

  // On a phone a scene is drawn smaller, so that the width holds it beside its colour bar.
  function shrinkScenes(layout) {
    Object.keys(layout).filter((key) => key.startsWith("scene")).forEach((key) => {
      const { x, y, z } = layout[key].aspectratio;
      layout[key] = { ...layout[key], aspectratio: { x: x * NARROW_SCENE, y: y * NARROW_SCENE, z: z * NARROW_SCENE } };
    });
  }

  // Under a finger the page scrolls, also over charts; scenes are turned after a tap on their button.
  function holdStill(layout) {
    layout.dragmode = false;
    Object.keys(layout).filter((key) => key.startsWith("scene")).forEach((key) => {
      layout[key] = { ...layout[key], dragmode: false };
    });
  }

  function offerTurning(node) {
    const scenes = scenesOf(node);
    if (!scenes.length) return;
    const button = document.createElement("button");
    button.type = "button";
    button.className = "turn";
    const turn = (on) => {
      button.textContent = on ? "Done" : "Turn";
      node.querySelectorAll(".gl-container").forEach((part) => { part.style.pointerEvents = on ? "" : "none"; });
      Plotly.relayout(node, Object.fromEntries(scenes.map((key) => [`${key}.dragmode`, on ? "turntable" : false])));
    };
    button.addEventListener("click", () => turn(button.textContent === "Turn"));
    node.append(button);
    turn(false);
  }

  // Charts side by side keep their width on a phone, and are scrolled.
  function sideBySide(layout) {
    return Object.entries(layout).some(([key, axis]) =>
      key.startsWith("scene2") || (key.startsWith("xaxis") && axis.domain && axis.domain[0] > 0));
  }

  function linkScenes(node) {
    const scenes = scenesOf(node);
    node.on("plotly_relayout", (change) => {
      const moved = scenes.find((scene) => change[`${scene}.camera`]);
      if (!moved) return;
      const update = {};
      scenes.filter((scene) => scene !== moved && !change[`${scene}.camera`])
        .forEach((scene) => { update[`${scene}.camera`] = change[`${moved}.camera`]; });
      if (Object.keys(update).length) Plotly.relayout(node, update);
    });
  }

  // What is hovered in one chart along the path is shown in the others: lines by their labels, scenes by a dot.
  let pointed = null;

  function linkWaypoints(number, node) {
    node.on("plotly_hover", (event) => {
      const custom = event.points[0].customdata;
      if (!custom || pointed !== null) return;
      pointed = Number(custom[0]);
      window.requestAnimationFrame(() => {
        drawn.forEach((other) => {
          if (other !== number && page.charts[other].along && inSight(element(other))) pointAt(element(other), pointed);
        });
        pointed = null;
      });
    });
  }

  function inSight(node) {
    const box = node.getBoundingClientRect();
    return box.height > 0 && box.bottom > 0 && box.top < window.innerHeight;
  }

  function nearest(custom, waypoint) {
    let best = 0;
    for (let row = 1; row < custom.length; row += 1) {
      if (Math.abs(custom[row][0] - waypoint) < Math.abs(custom[best][0] - waypoint)) best = row;
    }
    return best;
  }

  function pointAt(node, waypoint) {
    const points = [];
    const dots = {};
    node._fullData.forEach((trace, curveNumber) => {
      if (!trace.customdata || !trace.customdata.length || trace.visible !== true) return;
      const pointNumber = nearest(trace.customdata, waypoint);
      if (trace.type === "scatter3d") {
        const place = { x: trace.x[pointNumber], y: trace.y[pointNumber], z: trace.z[pointNumber] };
        if (Number.isFinite(place.x)) dots[trace.scene || "scene"] = place;
      } else {
        points.push({ curveNumber, pointNumber });
      }
    });
    if (points.length) {
      const subplots = [...new Set(points.map(({ curveNumber }) => {
        const trace = node._fullData[curveNumber];
        return `${trace.xaxis}${trace.yaxis}`;
      }))];
      Plotly.Fx.hover(node, points, subplots);
    }
    Object.entries(dots).forEach(([scene, place]) => {
      const text = `waypoint ${waypoint}`;
      const note = { ...place, text, ax: 0, ay: -28, arrowhead: 2, arrowsize: 0.9, font: { size: 11 } };
      Plotly.relayout(node, { [`${scene}.annotations`]: [note] });
    });
  }

  // A chart in a fold is drawn when the fold is opened, in the width that it then has.
  function drawWithin(fold) {
    fold.querySelectorAll(".plot").forEach((node) => {
      const number = Number(node.id.slice("chart-".length));
      if (!node.closest("details:not([open])") && window.Plotly) {
        if (drawn.has(number)) Plotly.Plots.resize(node);
        else draw(number);
      }
    });
  }

  function openTarget() {
    const target = window.location.hash.length > 1 && document.getElementById(window.location.hash.slice(1));
    if (target && target.tagName === "DETAILS") {
      target.open = true;
      target.scrollIntoView();
    }
  }

  const folds = [...document.querySelectorAll("details")];
  const unfold = document.getElementById("unfold");
  unfold.hidden = !folds.length;
  unfold.addEventListener("click", () => {
    const wanted = unfold.textContent === "Open all";
    folds.forEach((fold) => { fold.open = wanted; });
    unfold.textContent = wanted ? "Close all" : "Open all";
  });
  window.addEventListener("hashchange", openTarget);
  document.querySelectorAll("nav a").forEach((link) => link.addEventListener("click", () => window.setTimeout(openTarget, 0)));
  openTarget();

  function paint(name) {
    if (root.dataset.theme === name) return;
    root.dataset.theme = name;
    if (button) button.textContent = name === "dark" ? "Light" : "Dark";
    drawn.forEach((number) => Plotly.relayout(element(number), { template: page.themes[name] }));
  }

  const scenesOf = (node) => Object.keys(node._fullLayout).filter((key) => /^scene\d*$/.test(key));

  // Lines are drawn anew in the width of A4; a scene is frozen to a picture, which is drawn smaller.
  function fitPaper(node) {
    const scenes = scenesOf(node);
    if (!scenes.length) {
      const height = Math.min(node.clientHeight, PAPER_HEIGHT);
      node.dataset.height = node.style.height;
      node.style.height = `${height}px`;
      Plotly.relayout(node, { width: PAPER_WIDTH, height, autosize: false });
      return;
    }
    scenes.forEach((key) => {
      const { _scene: scene } = node._fullLayout[key];
      const picture = new Image();
      picture.src = scene.toImage("png");
      picture.className = "frozen";
      scene.container.append(picture);
    });
    const width = node._fullLayout.width;
    node.style.width = `${width}px`;
    node.style.zoom = Math.min(PAPER_WIDTH / width, 1);
  }

  function fitScreen(node) {
    node.querySelectorAll("img.frozen").forEach((picture) => picture.remove());
    node.style.zoom = node.style.width = "";
    if (node.dataset.height) node.style.height = node.dataset.height;
    Plotly.relayout(node, { width: null, height: null, autosize: true });
  }

  function drawNext(number) {
    if (number >= page.charts.length) return;
    if (!element(number).closest("details:not([open])")) draw(number);
    window.setTimeout(() => drawNext(number + 1), 0);
  }

  paint(theme());
  button.hidden = false;
  button.addEventListener("click", () => {
    chosen = root.dataset.theme === "dark" ? "light" : "dark";
    paint(chosen);
  });
  system.addEventListener("change", () => paint(theme()));
  if (!page.charts.length) return;
  try {
    await unpackLibrary();
  } catch (error) {
    document.getElementById("without-charts").hidden = false;
    return;
  }
  window.addEventListener("beforeprint", () => {
    paint("light");
    page.charts.forEach((_, number) => {
      if (element(number).closest("details:not([open])")) return;
      draw(number);
      fitPaper(element(number));
    });
  });
  window.addEventListener("afterprint", () => {
    paint(theme());
    drawn.forEach((number) => fitScreen(element(number)));
  });
  folds.forEach((fold) => fold.addEventListener("toggle", () => { if (fold.open) drawWithin(fold); }));
  drawNext(0);
})();
