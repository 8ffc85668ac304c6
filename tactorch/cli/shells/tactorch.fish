# Completion of tactorch in fish. For good:
#   tactorch completion fish > ~/.config/fish/completions/tactorch.fish
function __tactorch_complete
    set -l words (commandline --tokenize --cut-at-cursor --current-process)
    set -l current (commandline --cut-at-cursor --current-token)
    $words[1] completion words $words[2..-1] "$current" 2>/dev/null
end
complete --command tactorch --no-files --keep-order --arguments '(__tactorch_complete)'
