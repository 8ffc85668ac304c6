#compdef tactorch
# Completion of tactorch in zsh. For good, in ~/.zshrc, after compinit:
#   eval "$(tactorch completion zsh)"
_tactorch() {
    local line word about
    local -a open closed said_open said_closed
    for line in "${(@f)$(${words[1]} completion words "${(@Q)words[2,CURRENT-1]}" "${(Q)PREFIX}" 2>/dev/null)}"; do
        [[ -n $line ]] || continue
        word=${line%%$'\t'*} about=""
        [[ $line == *$'\t'* ]] && about="  -- ${line#*$'\t'}"
        if [[ $word == *[=./] ]]; then
            open+=("$word") said_open+=("$word$about")
        else
            closed+=("$word") said_closed+=("$word$about")
        fi
    done
    (( $#open )) && compadd -V settings -l -S '' -d said_open -a open
    (( $#closed )) && compadd -V words -l -d said_closed -a closed
    (( $#open + $#closed ))
}
if [[ $funcstack[1] == _tactorch ]]; then
    _tactorch "$@"  # loaded from a folder of fpath
else
    compdef _tactorch tactorch
fi
