// What goes wrong on a page, for whoever tests the page: in an attribute of its body.

const errors = [];
const report = (text) => {
  errors.push(String(text));
  document.body.dataset.errors = JSON.stringify(errors);
};
window.addEventListener("error", (event) => report(event.message));
window.addEventListener("unhandledrejection", (event) => report(event.reason));
document.addEventListener("securitypolicyviolation", (event) =>
  report(`blocked: ${event.violatedDirective} ${event.blockedURI}`));
