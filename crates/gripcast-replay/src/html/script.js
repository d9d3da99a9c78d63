"use strict";
(() => {
  const form = document.querySelector(".filters");
  const table = document.querySelector(".index");
  if (!form || !table) return;
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const articles = [...document.querySelectorAll("article")];
  const output = form.querySelector("output");

  // Rows come in the order of the articles before anything is sorted.
  const filter = () => {
    const object = form.elements.object.value;
    const mark = form.elements.mark.value;
    const text = form.elements.text.value.toLowerCase();
    let shown = 0;
    pairs.forEach(([row, article]) => {
      const is =
        (!object || row.dataset.object === object) &&
        (!mark || row.dataset.marks.split(" ").includes(mark)) &&
        row.cells[0].textContent.toLowerCase().includes(text);
      row.hidden = article.hidden = !is;
      shown += is;
    });
    output.textContent = `${shown} of ${pairs.length} grasps`;
  };
  const pairs = rows.map((row, i) => [row, articles[i]]);
  form.addEventListener("input", filter);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.hidden = false;
  filter();

  // A link to a grasp that the filter hides shows all grasps again.
  window.addEventListener("hashchange", () => {
    const target = document.getElementById(location.hash.slice(1));
    if (target && target.hidden) {
      form.reset();
      filter();
      target.scrollIntoView();
    }
  });

  const key = (row, column) => {
    const text = row.cells[column].textContent.trim();
    const fraction = /^(\d+) of (\d+)$/.exec(text);
    if (fraction) return fraction[1] / fraction[2];
    const number = Number(text.replace("−", "-"));
    return text !== "" && Number.isFinite(number) ? number : text;
  };
  const compare = (a, b) => {
    if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
    return typeof a === "number" ? -1 : 1;
  };
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const sorted = rows
        .map((row) => [key(row, column), row])
        .sort((a, b) => (up ? 1 : -1) * compare(a[0], b[0]));
      body.append(...sorted.map((pair) => pair[1]));
    });
  });

  window.addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach((details) => (details.open = true));
  });
})();
