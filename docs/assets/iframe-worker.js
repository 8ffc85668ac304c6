/* Pages that are opened from files may not start workers. The search of the theme then runs in a
 * hidden frame. It needs the constructor, postMessage and message events. */
if (window.location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.appendChild(frame)
      const inner = frame.contentWindow
      // The scripts of a worker are loaded one after the other, and all of its messages go to the page.
      inner.document.open()
      inner.document.write(
        "<!doctype html><body><script>" +
        "postMessage = (data) => parent.postMessage(data, '*');" +
        "importScripts = (...urls) => urls.reduce((before, url) => before.then(() =>" +
        "  new Promise((resolve, reject) => {" +
        "    const script = document.createElement('script');" +
        "    Object.assign(script, { src: url, onload: resolve, onerror: reject });" +
        "    document.body.appendChild(script)" +
        "  })), Promise.resolve());" +
        "<\/script><script src=\"" + encodeURI(String(url)) + "\"><\/script></body>"
      )
      inner.document.close()
      this.frame = frame
      this.onmessage = null
      this.loaded = new Promise((resolve) => { frame.addEventListener("load", resolve, { once: true }) })
      window.addEventListener("message", (event) => {
        if (event.source !== inner) return
        const copy = new MessageEvent("message", { data: event.data })
        this.dispatchEvent(copy)
        if (this.onmessage) this.onmessage(copy)
      })
    }

    postMessage(data) {
      this.loaded.then(() => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data })))
    }

    terminate() {
      this.frame.remove()
    }
  }
}
