// Errors are written where a test, or a reader of the page's source, can see them.
(function () {
  "use strict";
  var root = document.documentElement;
  root.dataset.error = "";
  window.addEventListener("error", function (event) {
    root.dataset.error += (event.message || "error") + "; ";
  });
  window.addEventListener("securitypolicyviolation", function (event) {
    root.dataset.error += "blocked: " + event.violatedDirective + "; ";
  });
})();
