
"use strict";
// Sorts and filters the table of variants, and draws them over two of their parameters. All text goes in as text.
(() => {
  const table = document.getElementById("variants");
  const heads = [...table.tHead.rows[0].cells];
  const rows = [...table.tBodies[0].rows];
  const titles = heads.map((head) => head.textContent);
  const values = new Map(rows.map((row) => [row, [...row.cells].map(valueOf)]));
  const shown = document.getElementById("shown");
  const note = shown.textContent;
  const tests = heads.map(() => () => true);
  let order = { column: -1, down: false };

  function valueOf(cell) {
    return cell.dataset.value === undefined ? null : JSON.parse(cell.dataset.value);
  }

  function make(name, more, ...inside) {
    const element = Object.assign(document.createElement(name), more);
    element.append(...inside);
    return element;
  }

  function distinct(column) {
    const found = new Set(rows.map((row) => values.get(row)[column]).filter((value) => value !== null));
    return [...found].sort(compare);
  }

  function compare(a, b) {
    return typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true });
  }

  function filter() {
    let count = 0;
    for (const row of rows) {
      row.hidden = !tests.every((test, column) => test(values.get(row)[column]));
      count += !row.hidden;
    }
    shown.textContent = `${count} of ${rows.length} variants are shown. ${note}`;
    draw();
  }

  function sort(column) {
    order = { column, down: order.column === column && !order.down };
    heads.forEach((head) => head.removeAttribute("aria-sort"));
    heads[column].setAttribute("aria-sort", order.down ? "descending" : "ascending");
    const sign = order.down ? -1 : 1;
    const sorted = [...rows].sort((one, other) => {
      const [a, b] = [values.get(one)[column], values.get(other)[column]];
      if (a === null || b === null) return (a === null) - (b === null); // what has no value comes last
      return sign * compare(a, b);
    });
    table.tBodies[0].append(...sorted);
  }

  function addRange(head, column) {
    const ends = ["least", "most"].map((name) => {
      const field = make("input", { type: "number", step: "any", placeholder: name });
      field.setAttribute("aria-label", `${titles[column]}, ${name}`);
      field.addEventListener("input", filter);
      return field;
    });
    tests[column] = (value) => {
      const [least, most] = ends.map((field) => field.valueAsNumber);
      if (Number.isNaN(least) && Number.isNaN(most)) return true;
      return value !== null && !(value < least) && !(value > most);
    };
    head.append(make("label", {}, ...ends));
  }

  function addChoice(head, column, choices) {
    const field = make("select", {}, make("option", { value: "", textContent: "all" }));
    choices.forEach((value, index) => field.append(make("option", { value: String(index), textContent: String(value) })));
    field.setAttribute("aria-label", titles[column]);
    field.addEventListener("change", filter);
    tests[column] = (value) => field.value === "" || value === choices[Number(field.value)];
    head.append(make("label", {}, field));
  }

  function addSearch(head, column) {
    const field = make("input", { type: "search", placeholder: "contains" });
    field.setAttribute("aria-label", titles[column]);
    field.addEventListener("input", filter);
    tests[column] = (value) => value !== null && String(value).toLowerCase().includes(field.value.toLowerCase());
    tests[column] = ((contains) => (value) => field.value === "" || contains(value))(tests[column]);
    head.append(make("label", {}, field));
  }

  heads.forEach((head, column) => {
    const kind = head.dataset.kind;
    if (kind === "none") return;
    const button = make("button", { type: "button", textContent: titles[column] });
    button.addEventListener("click", () => sort(column));
    head.replaceChildren(button);
    const choices = distinct(column);
    if (kind === "number") addRange(head, column);
    else if (choices.length <= 30 && choices.length < rows.length) addChoice(head, column, choices);
    else addSearch(head, column);
  });

  // the map: a circle for each variant that is shown, at two numbers of it, coloured by a third
  const map = document.getElementById("map");
  const columns = (role) => heads.map((_, i) => i).filter((i) => heads[i].dataset.kind === "number" && heads[i].dataset.role === role);
  const [places, scores] = [columns("parameter"), columns("score")];
  const chosen = {};
  const svgName = "http://www.w3.org/2000/svg";

  function svg(name, attributes, text) {
    const element = document.createElementNS(svgName, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    return element;
  }

  function span(column) {
    const found = rows.map((row) => values.get(row)[column]).filter((value) => value !== null);
    const [least, most] = [Math.min(...found), Math.max(...found)];
    return least < most ? [least, most] : [least - 0.5, least + 0.5];
  }

  function draw() {
    if (map.hidden) return;
    const [x, y, colour] = ["x", "y", "colour"].map((name) => Number(chosen[name].value));
    const [left, top, width, height] = [60, 30, 420, 240];
    const picture = svg("svg", { width: 680, height: 310, role: "img" });
    const [spanX, spanY, spanC] = [x, y, colour].map(span);
    const share = (value, [least, most]) => (value - least) / (most - least);
    const hue = (value) => `hsl(${Math.round(220 - 220 * share(value, spanC))} 80% 60%)`;
    picture.append(svg("rect", { x: left - 12, y: top - 4, width: width + 24, height: height + 14, fill: "none", stroke: "#444" }));
    for (const row of rows.filter((one) => !one.hidden)) {
      const [a, b, c] = [x, y, colour].map((column) => values.get(row)[column]);
      if (a === null || b === null) continue;
      const at = { cx: left + width * share(a, spanX), cy: top + height * (1 - share(b, spanY)), r: 8 };
      const circle = svg("circle", { ...at, fill: c === null ? "none" : hue(c), stroke: row.className ? "#ff6b6b" : "#777", "stroke-width": 2 });
      const told = [x, y, colour].map((column) => `${titles[column]}: ${values.get(row)[column] ?? "–"}`);
      circle.append(svg("title", {}, [values.get(row)[1], ...told].join("\n")));
      circle.addEventListener("click", () => row.scrollIntoView({ block: "center" }));
      picture.append(circle);
    }
    const number = (value) => String(Number(value.toPrecision(4)));
    spanX.forEach((value, i) => picture.append(svg("text", { x: left + width * i, y: top + height + 26, "text-anchor": "middle" }, number(value))));
    spanY.forEach((value, i) => picture.append(svg("text", { x: left - 18, y: top + height * (1 - i) + 4, "text-anchor": "end" }, number(value))));
    picture.append(svg("text", { x: left + width / 2, y: top + height + 26, "text-anchor": "middle" }, titles[x]));
    picture.append(svg("text", { x: 4, y: 12 }, titles[y]));
    [spanC[0], (spanC[0] + spanC[1]) / 2, spanC[1]].forEach((value, i) => {
      picture.append(svg("circle", { cx: left + width + 40, cy: top + 4 + 22 * i, r: 6, fill: hue(value) }));
      picture.append(svg("text", { x: left + width + 52, y: top + 8 + 22 * i }, number(value)));
    });
    picture.append(svg("text", { x: left + width + 34, y: 12 }, titles[colour]));
    map.lastElementChild.replaceWith(picture);
  }

  if (places.length > 1 && scores.length) {
    for (const [name, options, first] of [["x", places, 0], ["y", places, 1], ["colour", scores, 0]]) {
      chosen[name] = make("select", {}, ...options.map((i) => make("option", { value: String(i), textContent: titles[i] })));
      chosen[name].selectedIndex = first;
      chosen[name].addEventListener("change", draw);
      map.append(make("label", {}, `${name} `, chosen[name]));
    }
    map.append(make("div"));
    map.hidden = false;
  }
  filter();
})();
