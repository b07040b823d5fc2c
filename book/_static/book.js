// Paper is white, and what is folded cannot be opened on it; lists of records in tables would fill it, and stay folded.
(() => {
  let theme;
  let folded = [];
  addEventListener("beforeprint", () => {
    theme = document.documentElement.dataset.theme;
    document.documentElement.dataset.theme = "light";
    folded = [...document.querySelectorAll("details:not([open], td details)")];
    folded.forEach((details) => (details.open = true));
  });
  addEventListener("afterprint", () => {
    document.documentElement.dataset.theme = theme;
    folded.forEach((details) => (details.open = false));
  });
})();
