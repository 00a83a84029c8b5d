// Dialogs and passing messages.

const byId = (id) => document.getElementById(id);

/** Ask once more; resolves with whether the operator said yes. What is grave takes more than Enter by mistake. */
export function confirm({ title, text, names = "", yes, danger = false, grave = danger }) {
  const dialog = byId("confirm");
  byId("confirm-title").textContent = title;
  byId("confirm-text").textContent = text;
  byId("confirm-names").textContent = names;
  const button = byId("confirm-yes");
  button.textContent = `${yes} `;
  if (!grave) button.append(Object.assign(document.createElement("kbd"), { textContent: "Enter" }));
  button.classList.toggle("danger", danger);
  // Left over from the dialog before: Esc closes without a value.
  dialog.returnValue = "";
  dialog.showModal();
  (grave ? byId("confirm-cancel") : button).focus();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"), { once: true });
  });
}

export function askToken(why, onToken) {
  const dialog = byId("token-dialog");
  byId("token-text").textContent = why === "wrong token" ? "That token was wrong. Try again." : "Enter the token that stands in the dashboard's token file.";
  byId("token-text").classList.toggle("error", why === "wrong token");
  byId("token-form").onsubmit = (event) => {
    event.preventDefault();
    const token = byId("token").value.trim();
    byId("token").value = "";
    if (!token) return;
    dialog.close();
    onToken(token);
  };
  dialog.oncancel = (event) => event.preventDefault();
  if (!dialog.open) dialog.showModal();
  byId("token").focus();
}

export function toast(text, ok) {
  const toast = document.createElement("div");
  toast.className = ok ? "toast" : "toast bad";
  const words = document.createElement("span");
  words.textContent = text;
  const close = Object.assign(document.createElement("button"), { type: "button", textContent: "×", className: "quiet" });
  close.setAttribute("aria-label", "Dismiss");
  close.onclick = () => toast.remove();
  toast.append(words, close);
  byId("toasts").append(toast);
  // What failed stays until it is dismissed.
  if (ok) setTimeout(() => toast.remove(), 6000);
}
