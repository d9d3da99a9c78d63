// Runs before the first paint to avoid a white flash in dark mode.
(() => {
  const choices = ["auto", "light", "dark"];
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const stored = () => {
    try {
      return localStorage.getItem("gripcast-theme");
    } catch {
      return null;
    }
  };
  let choice = choices.includes(stored() ?? "") ? stored() : "auto";

  const apply = () => {
    const resolved = choice === "auto" ? (dark.matches ? "dark" : "light") : choice;
    document.documentElement.dataset.theme = resolved;
    const button = document.getElementById("theme");
    if (button) {
      button.textContent = { auto: "Auto", light: "Light", dark: "Dark" }[choice];
      button.setAttribute("aria-label", `Colours: ${choice}`);
    }
  };
  apply();
  dark.addEventListener("change", apply);
  document.addEventListener("DOMContentLoaded", () => {
    apply();
    document.getElementById("theme").addEventListener("click", () => {
      choice = choices[(choices.indexOf(choice) + 1) % choices.length];
      try {
        localStorage.setItem("gripcast-theme", choice);
      } catch {
        // Without storage the choice is kept until the page closes.
      }
      apply();
    });
  });
})();
